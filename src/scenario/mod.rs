/*! Disturbing a policy and watching what it does.

A scenario is a [`Script`]: a scene, a command and what happens when, all plain data. [`Playback`] plays any script with
any [`Controller`](crate::policy::Controller) and yields a [`Trace`](crate::scenario::trace::Trace), frame by frame; [`metrics`] reads traces. With
[`Sensing::Estimated`] the controller acts on sensors, not on the true state. Nothing here is ever seen in
training.
*/

pub mod calibration;
pub mod catalog;
pub mod estimation;
pub mod metrics;
mod playback;
pub mod rig;
pub mod senses;
pub mod session;
pub mod spring;
pub mod terrain;
pub mod trace;

use serde::{Deserialize, Serialize};

use crate::sim::Scene;
use crate::sim::{Conditions, Pull, Push};
use crate::task::Command;

pub use playback::{Playback, PlaybackStep};
pub use rig::Rig;
pub use senses::{Sensing, SensingError};
pub use spring::Spring;

/// A push at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimedPush {
    /// When \[s\].
    pub time_s: f64,
    /// Heading frame.
    pub push: Push,
}

/// What happens in a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// Robot, ground, obstacles.
    pub scene: Scene,
    /// Slope, friction, encoder offsets.
    pub conditions: Conditions,
    /// What the policy is asked to do, from the start to the end.
    pub command: Command,
    /// Length of the rollout \[s\].
    pub duration_s: f64,
    /// Length that is still played after a fall \[s\].
    pub after_fall_s: f64,
    /// In order of time.
    pub pushes: Vec<TimedPush>,
    /// A leash that pulls with a constant force.
    pub pull: Option<Pull>,
    /// A leash in the hand of somebody who walks, or a wall that gives.
    pub spring: Option<Spring>,
    /// A load on a rope.
    pub rig: Option<Rig>,
    /// What there is to be reached.
    pub goal: Option<Goal>,
}

impl Script {
    /// Commands a compliance where none is commanded [m/s/N].
    pub fn tell(&mut self, compliance: f64) {
        if self.command.compliance == 0.0 {
            self.command.compliance = compliance;
        }
    }

    /// What was asked for and comes after the end, in words.
    pub fn too_late(&self) -> Option<String> {
        let push = self.pushes.first().map(|push| ("push", push.time_s));
        let pull = self.pull.map(|pull| ("pull", pull.from_s));
        let spring = self.spring.as_ref().map(|spring| ("start of the leash", spring.from_s));
        let release = self.rig.as_ref().map(|rig| ("release of the load", rig.release_s));
        let (what, at_s) =
            [push, pull, spring, release].into_iter().flatten().find(|(_, at_s)| *at_s >= self.duration_s)?;
        Some(format!(
            "the {what} at {at_s:.2} s would come after the end at {:.2} s: it does not happen",
            self.duration_s
        ))
    }
}

/// A line across the way.
#[derive(Debug, Clone, PartialEq)]
pub struct Goal {
    /// The body from which the way is measured; without, the robot's start.
    pub from: Option<&'static str>,
    /// The trunk is there when it is this far ahead (world frame, x) \[m\].
    pub ahead_m: f64,
    /// Half the line's width (y, both ways from the start): who passes beside its ends has gone round \[m\].
    pub half_width_m: f64,
    /// What to say then.
    pub text: &'static str,
    /// Whether the script is over a second later.
    pub is_end: bool,
}

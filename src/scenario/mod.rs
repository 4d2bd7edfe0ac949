/*! Scenarios: disturbances of a policy, and how it reacts.

A scenario is a [`Script`]: a scene, a command and what happens when, all plain data. [`Playback`] plays any script with
any [`Controller`](crate::policy::Controller) and yields a [`Trace`](crate::scenario::trace::Trace), frame by frame; [`metrics`] reads traces. With
[`Sensing::Estimated`] the controller acts on sensors, not on the true state. Nothing here is ever seen in
training.
*/

pub mod calibration;
pub mod catalog;
pub mod estimation;
pub mod force_sense;
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

/// A push at a given time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimedPush {
    /// Time of the push \[s\].
    pub time_s: f64,
    /// The push, heading frame.
    pub push: Push,
}

/// The scene, the command and the disturbances of one playback.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// Robot, ground, obstacles.
    pub scene: Scene,
    /// Slope, friction, encoder offsets.
    pub conditions: Conditions,
    /// The command from start to end.
    pub command: Command,
    /// Length of the playback \[s\].
    pub duration_s: f64,
    /// Time still played after a fall \[s\].
    pub after_fall_s: f64,
    /// The pushes in order of time.
    pub pushes: Vec<TimedPush>,
    /// A leash that pulls with a constant force.
    pub pull: Option<Pull>,
    /// A spring: a leash whose other end moves, or a soft wall.
    pub spring: Option<Spring>,
    /// A load on a rope.
    pub rig: Option<Rig>,
    /// The goal to reach.
    pub goal: Option<Goal>,
}

impl Script {
    /// Sets the commanded compliance [m/s/N] if the script commands none.
    pub fn command_compliance(&mut self, compliance: f64) {
        if self.command.compliance == 0.0 {
            self.command.compliance = compliance;
        }
    }

    /// Describes the first disturbance that would come after the script's end, if any.
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

/// A finish line across the course.
#[derive(Debug, Clone, PartialEq)]
pub struct Goal {
    /// The body from which the distance is measured; `None` for the robot's start.
    pub from: Option<&'static str>,
    /// Distance at which the trunk has reached the goal (world frame, x) \[m\].
    pub ahead_m: f64,
    /// Half the line's width (y, both sides of the start); a robot that passes outside it has gone around \[m\].
    pub half_width_m: f64,
    /// Text of the success event.
    pub text: &'static str,
    /// True if the playback ends one second later.
    pub is_end: bool,
}

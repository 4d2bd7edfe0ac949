/*! Scenarios: disturbances of a policy, and how it reacts.

Read in this order: [`catalog::Scenario`] (parameters), [`Script`] (scene, command and disturbances, plain data),
[`Playback`] (plays a script with a [`Controller`](crate::policy::Controller)), [`Trace`](trace::Trace) (its frames and
events), [`metrics`] (numbers from traces). With [`Sensing::Estimated`] the controller acts on sensors, not on the true
state. [`session`] is for robots driven live. Policies never see a scenario in training.
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
///
/// ```
/// use supple::config::Config;
/// use supple::scenario::{TimedPush, catalog::Scenario};
/// use supple::sim::Push;
///
/// let mut script = Scenario::named("walk", "{duration_s: 3.0}")?.script(0, &Config::load("compliant")?)?;
/// assert!(script.pushes.is_empty());
/// let push = Push { linear: [0.0, 0.8], angular: [0.0; 3] }; // 0.8 m/s to the left
/// script.pushes.push(TimedPush { time_s: 1.0, push });
/// assert_eq!(script.too_late(), None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// The scene: robot, ground and obstacles.
    pub scene: Scene,
    /// Slope, friction and encoder bias.
    pub conditions: Conditions,
    /// The command, from start to end.
    pub command: Command,
    /// Length of the playback \[s\].
    pub duration_s: f64,
    /// Time that is still played after a fall \[s\].
    pub after_fall_s: f64,
    /// The pushes in order of time.
    pub pushes: Vec<TimedPush>,
    /// A constant pull on the trunk.
    pub pull: Option<Pull>,
    /// A spring: a leash whose other end moves, or a soft wall.
    pub spring: Option<Spring>,
    /// A load on a rope, such as a weight over a pulley.
    pub rig: Option<Rig>,
    /// The goal that the robot has to reach.
    pub goal: Option<Goal>,
}

impl Script {
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

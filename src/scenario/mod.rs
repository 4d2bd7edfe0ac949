/*! Scenarios: disturbances of a policy, and how it reacts.

Read in this order: [`catalog::Scenario`] (parameters), [`Script`] (scene, command and disturbances, plain data),
[`Playback`] (plays a script with a [`Controller`](crate::policy::Controller)), [`Trace`](trace::Trace) (its frames and
events), [`metrics`] (numbers from traces). With [`Sensing::Estimated`] the controller acts on sensors, not on the true
state. [`session`] is for robots driven live. Policies never see a scenario in training.
*/

pub mod calibration;
pub mod catalog;
pub mod estimation;
pub(crate) mod force_sense;
pub mod metrics;
mod playback;
pub mod senses;
pub mod session;
pub mod trace;

use crate::sim::{Conditions, Scene};
use crate::task::Command;
use crate::world::{Disturbance, Pull, Push};

pub use playback::{Beginning, Playback, PlaybackStep};
pub use senses::{Sensing, SensingError};

/// The scene, the command and the disturbances of one playback.
///
/// ```
/// use supple::config::Config;
/// use supple::scenario::catalog::Scenario;
/// use supple::world::{Disturbance, Push};
///
/// let mut script = Scenario::named("walk", "{duration_s: 3.0}")?.script(0, &Config::load("compliant")?)?;
/// assert!(script.disturbances.is_empty());
/// let push = Push { at_s: 1.0, linear: [0.0, 0.8], ..Push::default() }; // 0.8 m/s to the left
/// script.disturbances.push(Disturbance::Push(push));
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
    /// Rate at which the command leads the robot back to where commands alone would have led it \[1/s\]; 0 for none.
    pub set_point_per_s: f64,
    /// Length of the playback \[s\].
    pub duration_s: f64,
    /// Time that is still played after a fall \[s\].
    pub after_fall_s: f64,
    /// The disturbances of the robot.
    pub disturbances: Vec<Disturbance>,
    /// The goal that the robot has to reach.
    pub goal: Option<Goal>,
}

impl Script {
    /// Iterates over the pushes.
    pub fn pushes(&self) -> impl Iterator<Item = &Push> {
        self.disturbances.iter().filter_map(|it| if let Disturbance::Push(push) = it { Some(push) } else { None })
    }

    /// Returns the first pull.
    pub fn pull(&self) -> Option<&Pull> {
        self.disturbances.iter().find_map(|it| if let Disturbance::Pull(pull) = it { Some(pull) } else { None })
    }

    /// Returns the time until which nothing disturbs the robot or the scene \[s\]; infinite without disturbances. A rig carries its
    /// load from the start, and a set point acts from the start.
    pub fn undisturbed_s(&self) -> f64 {
        if self.set_point_per_s > 0.0 {
            return 0.0;
        }
        let from_s = |it: &Disturbance| if let Disturbance::Rig(_) = it { 0.0 } else { it.beginning().1 };
        self.disturbances.iter().map(from_s).fold(f64::INFINITY, f64::min)
    }

    /// Describes the first disturbance that would come after the script's end, if any.
    pub fn too_late(&self) -> Option<String> {
        let mut beginnings = self.disturbances.iter().map(Disturbance::beginning);
        let (what, at_s) = beginnings.find(|(_, at_s)| *at_s >= self.duration_s)?;
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

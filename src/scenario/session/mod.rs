/*! Interactive sessions: playbacks whose inputs arrive while they run and can be saved.

Start with [`Setup`] and [`LiveSession`], which plays one or two robots in the same scene on one clock. Commands,
pushes and pulls ([`Act`]) and changes of policy are [`Input`]s at a tick. A [`SavedSession`] is a file of these inputs, from which
the session is replayed bit for bit by the same code. [`LiveReadout`] computes the numbers shown while a robot is
driven.
*/

mod agent_cache;
mod live_session;
mod measure;
mod readout;
mod saved_session;
mod scene;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use agent_cache::AgentCache;
pub use live_session::{LiveSession, RATE_HZ, RobotStep};
pub use measure::{Take, takes};
pub use readout::{CARRIED_S, LiveReadout, Outcome, PullReading, PushReading, Reading};
pub use saved_session::{ReplayStep, SavedSession, SessionPart, SessionReplay, Writer};
pub use scene::SceneKind;

use crate::mujoco;
use crate::policy::AgentError;
use crate::policy::compliance::ComplianceError;
use crate::scenario::catalog::ScriptError;
use crate::task::Command;
use crate::util::files::FileError;

/// Error of a session, live or saved.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The policy does not exist or is invalid.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// A file is no policy or session, or the robot is invalid.
    #[error(transparent)]
    File(#[from] FileError),
    /// The policy or robot differs from the saved one.
    #[error("{what} has changed: its SHA-256 is {found}, expected {expected}; restore the original")]
    Changed {
        /// Name of the policy or robot.
        what: String,
        /// First digits of the saved SHA-256.
        expected: String,
        /// First digits of the SHA-256 that was found.
        found: String,
    },
    /// The scene cannot be built.
    #[error(transparent)]
    Script(#[from] ScriptError),
    /// The policy does not support the commanded compliance.
    #[error(transparent)]
    Compliance(#[from] ComplianceError),
    /// MuJoCo fails even after a reset.
    #[error(transparent)]
    Physics(#[from] mujoco::Error),
    /// The newer policy needs other rates, gains or latency.
    #[error("the newer policy has other rates, gains or latency: build a new scene for it")]
    OtherBody,
    /// An input has a number that no file can hold.
    #[error("a number of the input is not finite")]
    NotFinite,
    /// The setup has too few or too many robots, or an input names one that does not exist.
    #[error("robots: found {found}, expected {expected}")]
    Robots {
        /// Description of the number that was found.
        found: String,
        /// Description of the allowed numbers.
        expected: String,
    },
}

/// The setup of a session; the same setup always starts in the same state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Setup {
    /// Kind of the scene.
    pub scene: SceneKind,
    /// Seed of the scene's random parts.
    pub seed: u64,
    /// One or two robots, which receive the same inputs.
    pub robots: Vec<Seat>,
}

/// A robot and its policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seat {
    /// The requested policy: name of a shipped policy, file, or folder of a training run.
    pub policy: String,
    /// SHA-256 of the policy's files.
    pub sha256: String,
    /// The robot: name of a shipped robot, or its file.
    pub robot: String,
    /// SHA-256 of the robot's files.
    pub robot_sha256: String,
    /// Commanded compliance [m/s/N]; `None` leaves the policy its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compliance: Option<f64>,
}

impl Seat {
    /// Returns the short name of the policy: that of its file or folder without the path.
    pub fn label(&self) -> String {
        let name = std::path::Path::new(&self.policy).file_stem();
        name.map_or_else(|| self.policy.clone(), |name| name.to_string_lossy().into_owned())
    }
}

/// Unit of a push.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum PushUnit {
    /// Change of the trunk's velocity [m/s].
    #[serde(rename = "m/s")]
    Velocity,
    /// Momentum [kg·m/s]; divided by the robot's mass, it is the change of velocity.
    #[serde(rename = "N·s")]
    Momentum,
}

impl PushUnit {
    /// Converts a push of this size to the change of velocity [m/s] of a robot of this mass \[kg\].
    pub fn velocity(self, size: [f64; 2], mass_kg: f64) -> [f64; 2] {
        match self {
            PushUnit::Velocity => size,
            PushUnit::Momentum => size.map(|part| part / mass_kg),
        }
    }
}

/// An action on all robots, or on one that it names. The pages of `drive` send the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Act {
    /// Changes the velocity command; each robot keeps its compliance. A list of forward, left and yaw is read, too.
    Command(Command),
    /// Pushes the trunks, forward and left in the heading frame.
    Push {
        /// Size of the push, forward and left, in its unit.
        size: [f64; 2],
        /// Unit of the size.
        unit: PushUnit,
    },
    /// Pulls the trunks from now on, forward and left in the heading frame \[N\]; `None` ends the pull.
    #[serde(rename = "pull")]
    Hand(Option<[f64; 2]>),
    /// Changes the commanded compliance of one robot: see [`Seat::compliance`].
    Comply {
        /// Index of the robot.
        robot: usize,
        /// Commanded compliance [m/s/N]; `None` leaves the policy its own.
        compliance: Option<f64>,
    },
    /// Resets robots and scene to their start.
    Reset,
}

impl Act {
    /// Returns true if all numbers are finite; JSON has no others, so that a session with others could not be read again.
    pub fn is_finite(&self) -> bool {
        let all = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
        match self {
            Act::Command(Command { forward, left, yaw, compliance, .. }) => {
                all(&[*forward, *left, *yaw]) && compliance.is_none_or(f64::is_finite)
            }
            Act::Push { size: numbers, .. } | Act::Hand(Some(numbers)) => all(numbers),
            Act::Comply { compliance, .. } => compliance.is_none_or(f64::is_finite),
            Act::Hand(None) | Act::Reset => true,
        }
    }
}

/// An input to a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Input {
    /// Replaces the policy of one robot by a newer one from the same training run.
    Renew {
        /// Index of the robot.
        robot: usize,
        /// SHA-256 of the new policy.
        sha256: String,
    },
    /// Replaces the whole setup; command and pull are zero afterwards.
    Setup(Setup),
    /// Does something to the robots.
    #[serde(untagged)]
    Act(Act),
}

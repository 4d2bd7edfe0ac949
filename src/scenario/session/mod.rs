/*! Robots that somebody drives: the same playback, whose inputs come while it runs and can be kept.

A [`LiveSession`] is one robot or two in the same scene, on one clock. Whatever is done to it is an [`Input`] at a tick: commands,
pushes, the force of a hand, another policy. A [`SavedSession`] is a file of them, and so of everything that happened: the
world is played again from it bit for bit, by the code that played it first. [`LiveReadout`] has the numbers of a robot that is
being watched.
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

pub use agent_cache::{AgentCache, AgentCacheError};
pub use live_session::{LiveSession, LiveSessionError, RATE_HZ, RobotStep};
pub use measure::{Take, takes};
pub use readout::{CARRIED_S, LiveReadout, Outcome, PullReading, PushReading, Reading};
pub use saved_session::{ReplayStep, SavedSession, SessionError, SessionReplay, Writer};
pub use scene::SceneKind;

use crate::task::Command;

/// What is played: its start is the same each time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Setup {
    /// Where.
    pub scene: SceneKind,
    /// Seed of everything random in the scene.
    pub seed: u64,
    /// Who: one robot, or two that meet the same.
    pub robots: Vec<Seat>,
}

/// A robot and who moves it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seat {
    /// The policy as it was asked for: a name that ships, a file, a run's folder.
    pub policy: String,
    /// Identity of the policy.
    pub sha256: String,
    /// The robot: a name that ships, or its file.
    pub robot: String,
    /// Identity of the robot.
    pub robot_sha256: String,
    /// Compliance that it is told [m/s/N]; zero leaves it to the policy.
    #[serde(default)]
    pub compliance: f64,
}

impl Seat {
    /// What the policy is called for short: a file or folder by its name alone.
    pub fn label(&self) -> String {
        let name = std::path::Path::new(&self.policy).file_stem();
        name.map_or_else(|| self.policy.clone(), |name| name.to_string_lossy().into_owned())
    }
}

/// Unit of a push.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum PushUnit {
    /// Change of the trunk's velocity.
    #[serde(rename = "m/s")]
    Velocity,
    /// Momentum: the change of velocity is that over the robot's mass.
    #[serde(rename = "N·s", alias = "N s")]
    Momentum,
}

impl PushUnit {
    /// The change of velocity [m/s] that a push of this size is to a robot of this mass \[kg\].
    pub fn velocity(self, size: [f64; 2], mass_kg: f64) -> [f64; 2] {
        match self {
            PushUnit::Velocity => size,
            PushUnit::Momentum => size.map(|part| part / mass_kg),
        }
    }
}

/// Something that is done to the robots of a world, to all of them unless it names one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Input {
    /// They are asked to walk so from now on; each keeps its own compliance.
    Command(Command),
    /// Their trunks are pushed: forward and left, heading frame.
    Push {
        /// Size along each.
        size: [f64; 2],
        /// Of what.
        unit: PushUnit,
    },
    /// Their trunks are pulled from now on, forward and left in the heading frame \[N\], or let go.
    Pull(Option<[f64; 2]>),
    /// A robot is told to yield so far from now on: see [`Seat::compliance`].
    Comply {
        /// The robot.
        robot: usize,
        /// [m/s/N]
        compliance: f64,
    },
    /// Robots and scene are put back to their start.
    Reset,
    /// The policy of a robot has become another one: its run has saved a better one.
    Renew {
        /// The robot.
        robot: usize,
        /// Identity of the new policy.
        sha256: String,
    },
    /// Another world; the command is zero, and nobody pulls.
    Setup(Setup),
}

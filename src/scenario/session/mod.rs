/*! Robots that somebody drives: the same playback, whose inputs come while it runs and can be kept.

A [`World`] is one robot or two in the same scene, on one clock. Whatever is done to it is an [`Input`] at a tick: commands,
pushes, the force of a hand, another policy. A [`Session`] is a file of them, and so of everything that happened: the
world is played again from it bit for bit, by the code that played it first. [`Meter`] has the numbers of a robot that is
being watched.
*/

mod file;
mod measure;
mod meter;
mod scene;
mod shelf;
#[cfg(test)]
mod tests;
mod world;

use serde::{Deserialize, Serialize};

pub use file::{Playback, Session, SessionError, Step, Writer};
pub use measure::{Take, takes};
pub use meter::{CARRIED_S, Meter, Outcome, PullReading, PushReading, Reading};
pub use scene::SceneKind;
pub use shelf::{Shelf, ShelfError};
pub use world::{Played, RATE_HZ, World, WorldError};

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

/// A robot and who moves it. What can be set for each robot apart belongs here, with a default that means "as it was before".
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
}

/// Unit of a push.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// Change of the trunk's velocity.
    #[serde(rename = "m/s")]
    Velocity,
    /// Momentum: the change of velocity is that over the robot's mass.
    #[serde(rename = "N·s", alias = "N s")]
    Momentum,
}

/// Something that is done to all robots of a world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Input {
    /// They are asked to walk so from now on.
    Command(Command),
    /// Their trunks are pushed: forward and left, heading frame.
    Push {
        /// Size along each.
        size: [f64; 2],
        /// Of what.
        unit: Unit,
    },
    /// Their trunks are pulled from now on, forward and left in the heading frame \[N\], or let go.
    Pull(Option<[f64; 2]>),
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

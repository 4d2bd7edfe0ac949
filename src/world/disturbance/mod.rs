/*! Disturbances: pushes, pulls, leashes, walls, loads on ropes and held feet, as values with a course in time.

A [`Disturbance`] is plain data: the plan of an episode and the script of a scenario list them, and `drive` adds pushes and pulls. The
[`World`](super::World) applies them. Each kind has its own file, which says when it acts, which force it exerts in a given state, which
[`Event`]s it causes and how it is drawn.
*/

mod hold;
mod pull;
mod push;
mod rig;
mod spring;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

pub use hold::Hold;
pub use pull::{Profile, Pull, PullFrame};
pub use push::Push;
pub use rig::{Holder, Load, LoadShape, Rig, Rope};
pub use spring::{Spring, SpringEnd, SpringState};

use crate::mujoco::{Data, Result};
use crate::observation::Command;
use crate::sim::Sim;

/// A disturbance of the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Disturbance {
    /// A change of the trunk's velocity.
    Push(Push),
    /// A force on the trunk.
    Pull(Pull),
    /// A spring between the trunk and a point: a leash whose holder walks, or a soft wall.
    Spring(Spring),
    /// A load on a rope: a weight over a pulley, or a ball on a string.
    Rig(Rig),
    /// A foot that is held while it swings low.
    Hold(Hold),
}

impl Disturbance {
    /// Returns the name of its beginning, for texts, and the time of it \[s\].
    pub fn beginning(&self) -> (&'static str, f64) {
        match self {
            Disturbance::Push(push) => ("push", push.at_s),
            Disturbance::Pull(pull) => ("pull", pull.from_s),
            Disturbance::Spring(spring) => ("start of the leash", spring.from_s),
            Disturbance::Rig(rig) => ("release of the load", rig.release_s),
            Disturbance::Hold(hold) => ("hold of a foot", hold.from_s),
        }
    }
}

/// The beginning of a policy step, which decides what acts in the step.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepTime {
    pub(super) time_s: f64,
    pub(super) period_s: f64,
}

impl StepTime {
    /// Returns true if an instant has come: it is nearer to this step's beginning than to that of the next one, or earlier.
    pub(super) fn has_come(self, at_s: f64) -> bool {
        at_s < self.time_s + 0.5 * self.period_s
    }

    /// Returns true if the step begins within an interval.
    fn is_within(self, from_s: f64, until_s: f64) -> bool {
        self.is_after(from_s) && !self.is_after(until_s)
    }

    /// Returns true if the step begins at a time or later. Times of steps are products: they may be off by a rounding.
    fn is_after(self, time_s: f64) -> bool {
        time_s <= self.time_s + 1e-9
    }
}

/// An event of a playback.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// Simulation time \[s\].
    pub time_s: f64,
    /// Kind of the event.
    pub kind: EventKind,
    /// Text of the event.
    pub text: String,
}

/// Kinds of events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A disturbance began or ended.
    Disturbance,
    /// The robot fell.
    Fall,
    /// The robot completed the scenario's task (crossed, passed, recovered).
    Success,
    /// The physics or the sensors failed.
    Fault,
}

impl Event {
    /// Creates the event of a disturbance.
    pub fn disturbance(time_s: f64, text: impl Into<String>) -> Self {
        Event { time_s, kind: EventKind::Disturbance, text: text.into() }
    }
}

/// The drawn mark of a disturbance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum DisturbanceMark {
    /// An arrow: a sudden change of the trunk's velocity.
    Push {
        /// Change of velocity, world frame [m/s].
        velocity: [f64; 3],
    },
    /// A rope that pulls the trunk.
    #[serde(rename = "pull")]
    Rope {
        /// Force on the trunk, world frame \[N\].
        force: [f64; 3],
    },
    /// An arrow that ends at the trunk: an obstacle presses on it.
    Press {
        /// Force on the trunk, world frame \[N\].
        force: [f64; 3],
    },
}

/// The effects of the disturbances at the beginning of a policy step.
#[derive(Debug, Default)]
pub(super) struct Effects {
    pub(super) events: Vec<Event>,
    /// Impulse of the pushes, world frame [N·s].
    pub(super) impulse: Vector3<f64>,
    /// Change of velocity by the last push, world frame [m/s].
    pub(super) pushed: Option<Vector3<f64>>,
}

/// A disturbance in a world: its value, and its memory from step to step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Acting {
    /// A push, which is over once it has come.
    Push(Push, bool),
    Pull(Pull, pull::Memory),
    Spring(Spring, spring::Memory),
    Rig(Rig, rig::Memory),
    Hold(Hold, hold::Memory),
}

impl Acting {
    /// Prepares a disturbance in a scene.
    ///
    /// # Errors
    /// The scene lacks a part of it.
    pub(super) fn new(what: Disturbance, sim: &Sim) -> Result<Self> {
        Ok(match what {
            Disturbance::Push(push) => match push.pull(sim.robot().mass_kg, sim.policy_period_s()) {
                Some(pull) => Acting::Pull(pull, pull::Memory::default()),
                None => Acting::Push(push, false),
            },
            Disturbance::Pull(pull) => Acting::Pull(pull, pull::Memory::default()),
            Disturbance::Spring(spring) => Acting::Spring(spring, spring::Memory::new(sim)?),
            Disturbance::Rig(rig) => {
                let memory = rig::Memory::new(&rig, sim)?;
                Acting::Rig(rig, memory)
            }
            Disturbance::Hold(hold) => Acting::Hold(hold, hold::Memory::default()),
        })
    }

    /// Prepares the policy step that begins at `at`.
    ///
    /// # Errors
    /// MuJoCo fails in the disturbed state.
    pub(super) fn before_step(
        &mut self,
        at: StepTime,
        command: &Command,
        sim: &mut Sim,
        effects: &mut Effects,
    ) -> Result<()> {
        match self {
            Acting::Push(push, is_over) => *is_over = push.before_step(at, sim, effects)?,
            Acting::Pull(pull, memory) => memory.before_step(pull, at, sim, &mut effects.events),
            Acting::Spring(..) => {}
            Acting::Rig(rig, memory) => memory.before_step(rig, at, command, sim, &mut effects.events)?,
            Acting::Hold(hold, memory) => memory.before_step(hold, at),
        }
        Ok(())
    }

    /// Returns the force on the trunk in the coming physics step, world frame \[N\]; `None` for kinds without one.
    pub(super) fn trunk_force(&mut self, data: &Data) -> Option<Vector3<f64>> {
        match self {
            Acting::Pull(pull, memory) => Some(memory.force(pull, data.time_s())),
            Acting::Spring(spring, memory) => Some(memory.force(spring, data)),
            Acting::Push(..) | Acting::Rig(..) | Acting::Hold(..) => None,
        }
    }

    /// Returns true if the disturbance has come and gone after the step that began at `at`.
    pub(super) fn is_over(&self, at: StepTime) -> bool {
        match self {
            Acting::Push(_, is_over) => *is_over,
            Acting::Pull(Pull { until_s, .. }, _) | Acting::Hold(Hold { until_s, .. }, _) => at.is_after(*until_s),
            Acting::Spring(..) | Acting::Rig(..) => false,
        }
    }
}

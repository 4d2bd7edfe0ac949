//! Pushes: sudden changes of the trunk's velocity.

use serde::{Deserialize, Serialize};

use super::{Effects, Event, StepTime};
use crate::mujoco::Result;
use crate::sim::Sim;

/// A sudden change of the trunk's velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Push {
    /// Time of the push \[s\].
    pub at_s: f64,
    /// Change of velocity, forward and left, heading frame [m/s].
    pub linear: [f64; 2],
    /// Change of angular velocity about the base's three axes [rad/s].
    pub angular: [f64; 3],
}

impl Push {
    /// Pushes the trunk if the push comes in the policy step that begins at `at`; returns true if it does.
    pub(super) fn before_step(&self, at: StepTime, sim: &mut Sim, effects: &mut Effects) -> Result<bool> {
        if !at.has_come(self.at_s) {
            return Ok(false);
        }
        let before = sim.state().velocity_in_world();
        sim.push(self.linear, self.angular)?;
        let change = sim.state().velocity_in_world() - before;
        effects.impulse += sim.robot().mass_kg * change;
        effects.pushed = Some(change);
        let [forward, left] = self.linear;
        effects
            .events
            .push(Event::disturbance(at.time_s, format!("push: {forward:+.2} m/s forward, {left:+.2} m/s left")));
        Ok(true)
    }
}

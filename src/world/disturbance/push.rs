//! Pushes: changes of the trunk's velocity, in an instant or within a short time.

use serde::{Deserialize, Serialize};

use super::{Effects, Event, Pull, PullFrame, StepTime};
use crate::mujoco::Result;
use crate::sim::Sim;

/// A change of the trunk's velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Push {
    /// Time of the push \[s\].
    pub at_s: f64,
    /// Change of velocity, forward and left, heading frame [m/s].
    pub linear: [f64; 2],
    /// Change of angular velocity about the base's three axes [rad/s].
    pub angular: [f64; 3],
    /// Time over which a steady force on the trunk gives the robot the momentum of `linear` \[s\]; 0 for an instant.
    #[serde(default, skip_serializing_if = "instant")]
    pub for_s: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn instant(for_s: &f64) -> bool {
    *for_s == 0.0
}

impl Push {
    /// Returns the pull that gives a robot the same momentum, in whole policy steps of `period_s` \[s\]; `None` for a push in an instant.
    pub(super) fn pull(&self, mass_kg: f64, period_s: f64) -> Option<Pull> {
        let for_s = period_s * (self.for_s / period_s).round().max(1.0);
        let force = self.linear.map(|change| mass_kg * change / for_s);
        let pull = Pull::constant([self.at_s, self.at_s + for_s], force);
        (self.for_s > 0.0).then_some(Pull { frame: PullFrame::Heading, ..pull })
    }

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

//! Pushes: sudden changes of the trunk's velocity.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{Event, StepTime};
use crate::mujoco::Result;
use crate::sim::Sim;

/// Time for which the arrow of a push stays in the frames \[s\].
const SHOWN_S: f64 = 0.3;

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

/// What a push has done.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(in crate::world) struct Memory {
    /// Time of the step in which it came \[s\], and its change of velocity, world frame [m/s]; `None` until then.
    done: Option<(f64, [f64; 3])>,
    /// True in the policy step in which it came.
    is_new: bool,
}

impl Memory {
    /// Pushes the trunk if the push is due.
    pub(super) fn before_step(
        &mut self,
        push: &Push,
        at: StepTime,
        sim: &mut Sim,
        events: &mut Vec<Event>,
    ) -> Result<()> {
        self.is_new = self.is_coming(push, at);
        if self.is_new {
            let before = sim.state().velocity_in_world();
            sim.push(push.linear, push.angular)?;
            self.done = Some((at.time_s, (sim.state().velocity_in_world() - before).into()));
            let [forward, left] = push.linear;
            events.push(Event::disturbance(at.time_s, format!("push: {forward:+.2} m/s forward, {left:+.2} m/s left")));
        }
        Ok(())
    }

    /// Returns true if the trunk is pushed in the policy step that begins at `at`.
    pub(in crate::world) fn is_coming(&self, push: &Push, at: StepTime) -> bool {
        self.done.is_none() && at.has_come(push.at_s)
    }

    /// Returns true if the push has come.
    pub(in crate::world) fn is_done(&self) -> bool {
        self.done.is_some()
    }

    /// Returns the change of velocity in this policy step, world frame [m/s], if the push came in it.
    pub(in crate::world) fn change(&self) -> Option<Vector3<f64>> {
        self.done.filter(|_| self.is_new).map(|(_, change)| change.into())
    }

    /// Returns the change of velocity, world frame [m/s], for as long as it is drawn.
    pub(in crate::world) fn shown(&self, time_s: f64) -> Option<[f64; 3]> {
        self.done.filter(|(done_s, _)| time_s <= done_s + SHOWN_S).map(|(_, change)| change)
    }

    /// Forgets what is drawn.
    pub(in crate::world) fn hide(&mut self) {
        self.done.iter_mut().for_each(|(done_s, _)| *done_s = f64::NEG_INFINITY);
    }
}

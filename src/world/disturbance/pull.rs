/*! Pulls: forces on the trunk during an interval, like that of a hand or a leash.

A pull acts in the policy steps that begin within its interval. Its size follows a [`Profile`] from physics step to physics
step; another course in time is one more variant there.
*/

use std::f64::consts::TAU;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{Event, StepTime};
use crate::sim::Sim;

/// A force on the trunk's centre of mass during an interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pull {
    /// Time at which the pull begins \[s\].
    pub from_s: f64,
    /// Time at which the pull ends \[s\].
    pub until_s: f64,
    /// Largest force, along x and y of its frame \[N\].
    pub force: [f64; 2],
    /// Course of the force in time.
    #[serde(default, skip_serializing_if = "Profile::is_constant")]
    pub profile: Profile,
    /// Frame of the force.
    #[serde(default)]
    pub frame: PullFrame,
}

/// The course of a force in time.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// The same force all the time.
    #[default]
    Constant,
    /// Grows evenly from nothing for `rise_s` \[s\], then stays.
    Ramp {
        /// Time until the whole force acts \[s\].
        rise_s: f64,
    },
    /// Swings to and fro, from nothing along the force first.
    Sine {
        /// Frequency \[Hz\].
        frequency_hz: f64,
    },
}

/// The frame of a pull's force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PullFrame {
    /// Forward and left at the robot's start: the world frame.
    #[default]
    World,
    /// Forward and left of the robot: the heading frame at the beginning of each policy step.
    Heading,
}

impl Profile {
    /// Returns the part of the force that acts `since_s` after its beginning \[s\].
    pub fn at(self, since_s: f64) -> f64 {
        match self {
            Profile::Constant => 1.0,
            Profile::Ramp { rise_s } => (since_s / rise_s.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0),
            Profile::Sine { frequency_hz } => (TAU * frequency_hz * since_s).sin(),
        }
    }

    fn is_constant(&self) -> bool {
        *self == Profile::Constant
    }
}

impl Pull {
    /// Creates a constant pull along x and y of the world frame \[N\] in an interval \[s\].
    pub fn constant([from_s, until_s]: [f64; 2], force: [f64; 2]) -> Self {
        Pull { from_s, until_s, force, profile: Profile::Constant, frame: PullFrame::World }
    }

    /// Creates the pull of a hand that goes along with the robot, forward and left of it \[N\], until it lets go.
    pub fn hand(force: [f64; 2]) -> Self {
        Pull { frame: PullFrame::Heading, ..Pull::constant([f64::NEG_INFINITY, f64::INFINITY], force) }
    }

    /// Returns true for [`Pull::hand`].
    pub(in crate::world) fn is_by_hand(&self) -> bool {
        self.frame == PullFrame::Heading && self.from_s == f64::NEG_INFINITY
    }

    /// Returns the force in the policy step that begins at `at`, before its profile, world frame \[N\]; `None` if it does not
    /// act.
    pub(in crate::world) fn in_step(&self, at: StepTime, sim: &Sim) -> Option<Vector3<f64>> {
        let force = Vector3::new(self.force[0], self.force[1], 0.0);
        at.is_within(self.from_s, self.until_s).then(|| match self.frame {
            PullFrame::World => force,
            PullFrame::Heading => sim.state().heading() * force,
        })
    }
}

/// The force of a pull before its profile in this policy step, world frame \[N\]; `None` while it does not act.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(in crate::world) struct Memory(Option<[f64; 3]>);

impl Memory {
    /// Checks whether the pull acts in the policy step that begins at `at`.
    pub(super) fn before_step(&mut self, pull: &Pull, at: StepTime, sim: &Sim, events: &mut Vec<Event>) {
        let before = std::mem::replace(&mut self.0, pull.in_step(at, sim).map(Into::into));
        let text = match (before, self.0) {
            (None, Some(_)) => format!("pull: {:+.1} N forward, {:+.1} N left", pull.force[0], pull.force[1]),
            (Some(_), None) => "pull ends".to_owned(),
            _ => return,
        };
        events.push(Event::disturbance(at.time_s, text));
    }

    /// Returns the force at a time of this policy step, world frame \[N\].
    pub(super) fn force(&self, pull: &Pull, time_s: f64) -> Vector3<f64> {
        self.0.map_or_else(Vector3::zeros, |force| pull.profile.at(time_s - pull.from_s) * Vector3::from(force))
    }

    /// Returns the force at a time of this policy step, world frame \[N\]; `None` if the pull does not act.
    pub(in crate::world) fn acting(&self, pull: &Pull, time_s: f64) -> Option<Vector3<f64>> {
        self.0.map(|_| self.force(pull, time_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_grow_stay_and_swing() {
        let ramp = Profile::Ramp { rise_s: 2.0 };
        assert_eq!([-1.0, 0.0, 0.5, 2.0, 9.0].map(|s| ramp.at(s)), [0.0, 0.0, 0.25, 1.0, 1.0]);
        assert_eq!(Profile::Ramp { rise_s: 0.0 }.at(0.1), 1.0);
        let sine = Profile::Sine { frequency_hz: 0.5 };
        for (since_s, expected) in [(0.0, 0.0), (0.5, 1.0), (1.0, 0.0), (1.5, -1.0)] {
            assert!((sine.at(since_s) - expected).abs() < 1e-12);
        }
        assert_eq!(Profile::Constant.at(7.0), 1.0);
    }
}

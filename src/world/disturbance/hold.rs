//! Held feet: a foot that swings low is held where it was caught, as by a branch or a cable.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::StepTime;
use crate::robot::Foothold;

/// A time at which a foot is held if it swings low.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Hold {
    /// Index of the leg in [`LEGS`](crate::robot::LEGS).
    pub leg: usize,
    /// Time from which it may be held \[s\].
    pub from_s: f64,
    /// Time until which it may be held \[s\].
    pub until_s: f64,
    /// Height of the obstacle: the foot is free above it \[m\].
    pub height_m: f64,
    /// Largest horizontal force \[N\].
    pub force_n: f64,
    /// Stiffness [N/m].
    pub stiffness_n_per_m: f64,
}

impl Hold {
    /// Returns the horizontal force on a foot at `place` that is held at `pin`, world frame \[N\].
    fn force(&self, place: [f64; 2], pin: [f64; 2]) -> [f64; 2] {
        let pull = [0, 1].map(|axis| self.stiffness_n_per_m * (pin[axis] - place[axis]));
        let size = pull[0].hypot(pull[1]);
        let cap = if size > self.force_n { self.force_n / size } else { 1.0 };
        pull.map(|force| cap * force)
    }
}

/// The memory of a hold.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(in crate::world) struct Memory {
    /// True in policy steps within the hold's interval.
    acts: bool,
    /// True if it acted in the step before.
    acted: bool,
    /// The place at which the foot is held, world frame \[m\]; `None` while it is free.
    pin: Option<[f64; 2]>,
}

impl Memory {
    /// Checks whether the foot may be held in the policy step that begins at `at`.
    pub(super) fn before_step(&mut self, hold: &Hold, at: StepTime) {
        (self.acted, self.acts) = (self.acts, at.is_within(hold.from_s, hold.until_s));
    }

    /// Returns true if the force on the foot may be another one than in the step before.
    pub(in crate::world) fn matters(&self) -> bool {
        self.acts || self.acted
    }

    /// Catches or frees the foot, whose centre is at `centre`, and returns the force on it, world frame \[N\].
    pub(in crate::world) fn force(&mut self, hold: &Hold, foot: Foothold, [x, y, _]: [f64; 3]) -> Vector3<f64> {
        if !self.acts || foot.contact || foot.height >= hold.height_m {
            self.pin = None;
            return Vector3::zeros();
        }
        let [x, y] = hold.force([x, y], *self.pin.get_or_insert([x, y]));
        Vector3::new(x, y, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spring_pulls_back_and_no_harder_than_its_force() {
        let hold = Hold { leg: 0, from_s: 0.0, until_s: 1.0, height_m: 0.05, force_n: 50.0, stiffness_n_per_m: 500.0 };
        assert_eq!(hold.force([0.03, 0.04], [0.0, 0.0]), [-15.0, -20.0]);
        // 0.2 m would be 100 N.
        let [x, y] = hold.force([0.12, 0.16], [0.0, 0.0]);
        assert!((x + 30.0).abs() < 1e-9 && (y + 40.0).abs() < 1e-9);
    }
}

//! The observer of the physics steps of a training step: swings of the feet, and the forces on them and those that hold them.

use nalgebra::Vector3;

use super::held_feet::HeldFeet;
use crate::mujoco::Data;
use crate::robot::{Foothold, Joints};
use crate::sim::{Ground, Parts, StepObserver};
use crate::task::SwingTracker;

/// Sums over the physics steps of one policy step.
#[derive(Debug)]
pub(super) struct StepMeter<'a> {
    /// The swings of the feet.
    pub(super) swings: &'a mut SwingTracker,
    /// The contact forces on the feet; `None` if nothing observes them, since they cost time.
    pub(super) foot_forces: Option<FootForces>,
    /// The feet that are held; `None` if none ever is.
    pub(super) held_feet: Option<HeldFeet<'a>>,
}

/// The force on each foot by contacts and by what holds it, summed over physics steps.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FootForces {
    sums: [Vector3<f64>; 4],
    steps: u32,
}

impl FootForces {
    /// Returns the mean force on each foot, world frame \[N\].
    pub(super) fn mean(&self) -> [Vector3<f64>; 4] {
        self.sums.map(|sum| sum / f64::from(self.steps.max(1)))
    }

    fn add(&mut self, data: &Data, parts: &Parts) {
        self.steps += 1;
        for contact in data.contacts() {
            // MuJoCo gives the force on the second geometry.
            for (geom, sign) in contact.geoms.into_iter().zip([-1.0, 1.0]) {
                if let Some(leg) = parts.feet().iter().position(|foot| *foot == geom) {
                    self.sums[leg] += sign * Vector3::from(data.contact_force(contact.index));
                }
            }
        }
    }
}

impl StepObserver for StepMeter<'_> {
    fn foot_forces(&mut self, data: &Data, parts: &Parts, ground: &Ground) -> Option<[Vector3<f64>; 4]> {
        let forces = self.held_feet.as_mut()?.forces(data, parts, ground);
        if let Some(sums) = &mut self.foot_forces {
            (0..4).for_each(|leg| sums.sums[leg] += forces[leg]);
        }
        Some(forces)
    }

    fn forces(&mut self, data: &Data, parts: &Parts, _torques: &Joints) {
        if let Some(forces) = &mut self.foot_forces {
            forces.add(data, parts);
        }
    }

    fn feet(&mut self, feet: &[Foothold; 4]) {
        self.swings.feet(feet);
    }
}

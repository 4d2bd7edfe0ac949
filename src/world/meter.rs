//! The step meter: makes the disturbances act in the physics steps of a policy step, and measures forces and swings.

use nalgebra::Vector3;

use super::disturbance::Acting;
use crate::mujoco::Data;
use crate::robot::{Foothold, Joints};
use crate::sim::{Ground, Parts, StepForces, StepObserver};
use crate::task::SwingTracker;

/// Sums and maxima over the physics steps of one policy step.
pub(super) struct StepMeter<'a, S> {
    pub(super) disturbances: &'a mut [Acting],
    pub(super) swings: &'a mut SwingTracker,
    /// Reads the sensors after each physics step.
    pub(super) sensors: S,
    /// True if contact forces are measured, which takes a twentieth of the time of a step.
    pub(super) measures_contacts: bool,
    pub(super) sums: StepForces,
    pub(super) substeps: u32,
    /// Number of physics steps with a force between the robot and obstacles.
    pub(super) obstacle_substeps: u32,
    /// Id of the first geometry of the robot that touched an obstacle.
    pub(super) touched: Option<usize>,
}

impl<S> StepMeter<'_, S> {
    /// Returns the forces of a policy step that took `period_s` \[s\].
    pub(super) fn forces(&self, period_s: f64) -> StepForces {
        let substeps = f64::from(self.substeps.max(1));
        StepForces {
            trunk: self.sums.trunk / substeps,
            feet: match self.measures_contacts {
                true => self.sums.feet.map(|sum| sum / substeps),
                // Forces that are not measured are NaN, not zero.
                false => [Vector3::repeat(f64::NAN); 4],
            },
            obstacle_impulse_n_s: self.sums.obstacle_impulse_n_s * period_s / substeps,
            obstacle_contact_s: f64::from(self.obstacle_substeps) * period_s / substeps,
            ..self.sums
        }
    }
}

impl<S: FnMut(&Data, &Parts, &Joints)> StepObserver for StepMeter<'_, S> {
    fn trunk_force(&mut self, data: &Data) -> Option<Vector3<f64>> {
        let force =
            self.disturbances.iter_mut().filter_map(|it| it.trunk_force(data)).reduce(|sum, force| sum + force)?;
        self.sums.trunk += force;
        Some(force)
    }

    fn foot_forces(&mut self, data: &Data, parts: &Parts, ground: &Ground) -> Option<[Vector3<f64>; 4]> {
        let matters = |it: &Acting| matches!(it, Acting::Hold(_, memory) if memory.matters());
        if !self.disturbances.iter().any(matters) {
            return None;
        }
        let (feet, centres) = (parts.footholds(data, ground), parts.foot_centres(data));
        let mut forces = [Vector3::zeros(); 4];
        for it in &mut *self.disturbances {
            if let Acting::Hold(hold, memory) = it {
                forces[hold.leg] += memory.force(hold, feet[hold.leg], centres[hold.leg]);
            }
        }
        self.sums.feet.iter_mut().zip(forces).for_each(|(sum, force)| *sum += force);
        Some(forces)
    }

    fn forces(&mut self, data: &Data, parts: &Parts, torques: &Joints) {
        (self.sensors)(data, parts, torques);
        self.substeps += 1;
        self.sums.torques = *torques;
        for it in &mut *self.disturbances {
            if let Acting::Rig(_, memory) = it {
                memory.measure(data);
            }
        }
        if !self.measures_contacts {
            return;
        }
        let (mut feet, mut obstacles) = ([Vector3::zeros(); 4], Vector3::zeros());
        for contact in data.contacts() {
            let [first, second] = contact.geoms;
            // MuJoCo gives the force on the second geometry; the sign turns it into the force on the robot.
            let (geom, other, sign) = match (parts.is_part(first), parts.is_part(second)) {
                (true, false) => (first, second, -1.0),
                (false, true) => (second, first, 1.0),
                _ => continue,
            };
            let force = sign * Vector3::from(data.contact_force(contact.index));
            if let Some(leg) = parts.feet().iter().position(|foot| *foot == geom) {
                feet[leg] += force;
            } else if data.model().geom_body(geom) == parts.trunk() {
                self.sums.trunk += force;
            }
            if other != parts.ground() {
                obstacles += force;
                self.touched = self.touched.or(Some(geom));
            }
        }
        for (sum, force) in self.sums.feet.iter_mut().zip(feet) {
            *sum += force;
            self.sums.peak_foot_n = self.sums.peak_foot_n.max(force.norm());
        }
        let obstacle_n = obstacles.norm();
        self.sums.peak_obstacle_n = self.sums.peak_obstacle_n.max(obstacle_n);
        self.sums.obstacle_impulse_n_s += obstacle_n;
        self.obstacle_substeps += u32::from(obstacle_n > 0.0);
    }

    fn feet(&mut self, feet: &[Foothold; 4]) {
        self.swings.feet(feet);
    }
}

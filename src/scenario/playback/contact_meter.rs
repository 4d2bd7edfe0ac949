//! The contact meter: forces and sensor readings over the physics steps of one policy step.

use nalgebra::Vector3;

use crate::mujoco::Data;
use crate::robot::{Foothold, Joints};
use crate::scenario::Spring;
use crate::scenario::force_sense::ForceSense;
use crate::scenario::rig::RopeForces;
use crate::scenario::senses::Senses;
use crate::scenario::spring::SpringState;
use crate::sim::{Parts, StepObserver};
use crate::task::SwingTracker;

/// Sums and maxima over the physics steps of one policy step.
#[derive(Default)]
pub(super) struct ContactMeter<'a> {
    pub(super) senses: Option<&'a mut Senses>,
    /// The observer of the forces from outside.
    pub(super) force_sense: Option<&'a mut ForceSense>,
    /// Sum over the physics steps of the true force on the trunk, world frame \[N\]; without a rope's.
    pub(super) trunk_force: Vector3<f64>,
    /// The constant force on the trunk, world frame \[N\].
    pub(super) pull: Vector3<f64>,
    /// The spring that also acts on the trunk.
    pub(super) spring: Option<(&'a Spring, &'a mut SpringState)>,
    pub(super) swings: SwingTracker,
    pub(super) substeps: u32,
    pub(super) torques: Joints,
    pub(super) foot_forces: [[f64; 3]; 4],
    pub(super) peak_foot_force_n: f64,
    pub(super) peak_obstacle_force_n: f64,
    pub(super) obstacle_force_sum_n: f64,
    /// Number of physics steps with a force between the robot and obstacles.
    pub(super) obstacle_substeps: u32,
    /// Id of the first geometry of the robot that touched an obstacle.
    pub(super) touched: Option<usize>,
    /// Id of the rope's tendon.
    pub(super) rope: Option<usize>,
    pub(super) rope_forces: RopeForces,
}

impl StepObserver for ContactMeter<'_> {
    fn trunk_force(&mut self, data: &Data) -> Option<Vector3<f64>> {
        let (spring, state) = self.spring.as_mut()?;
        let force = state.force(spring, data);
        self.trunk_force += force;
        Some(self.pull + force)
    }

    fn feet(&mut self, feet: &[Foothold; 4]) {
        self.swings.feet(feet);
    }

    fn forces(&mut self, data: &Data, parts: &Parts, torques: &Joints) {
        if let Some(senses) = &mut self.senses {
            senses.read(data, parts);
        }
        if let Some(force_sense) = &mut self.force_sense {
            // A fault is kept as a doubt beside the forces.
            let _ = force_sense.read(data, parts, torques, self.senses.as_deref());
        }
        self.trunk_force += self.pull;
        self.substeps += 1;
        self.torques = *torques;
        if let Some(tendon) = self.rope {
            self.rope_forces.add(data.tendon_limit_force(tendon));
        }
        let (mut feet, mut obstacles) = ([[0.0; 3]; 4], [0.0; 3]);
        for contact in data.contacts() {
            let [first, second] = contact.geoms;
            // MuJoCo gives the force on the second geometry; the sign turns it into the force on the robot.
            let (geom, other, sign) = match (parts.is_part(first), parts.is_part(second)) {
                (true, false) => (first, second, -1.0),
                (false, true) => (second, first, 1.0),
                _ => continue,
            };
            let on_second = data.contact_force(contact.index);
            if let Some(leg) = parts.feet().iter().position(|foot| *foot == geom) {
                (0..3).for_each(|k| feet[leg][k] += sign * on_second[k]);
            }
            if data.model().geom_body(geom) == parts.trunk() {
                self.trunk_force += sign * Vector3::from(on_second);
            }
            if other != parts.ground() {
                (0..3).for_each(|k| obstacles[k] += sign * on_second[k]);
                self.touched = self.touched.or(Some(geom));
            }
        }
        for (sum, force) in self.foot_forces.iter_mut().zip(feet) {
            (0..3).for_each(|k| sum[k] += force[k]);
            self.peak_foot_force_n = self.peak_foot_force_n.max(norm(force));
        }
        let obstacle_force_n = norm(obstacles);
        self.peak_obstacle_force_n = self.peak_obstacle_force_n.max(obstacle_force_n);
        self.obstacle_force_sum_n += obstacle_force_n;
        self.obstacle_substeps += u32::from(obstacle_force_n > 0.0);
    }
}

fn norm(force: [f64; 3]) -> f64 {
    force.iter().map(|value| value * value).sum::<f64>().sqrt()
}

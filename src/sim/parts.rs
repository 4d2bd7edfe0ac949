//! The robot in a compiled model: the ids of its parts, and its state.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::ground::Ground;
use super::scene::GROUND;
use crate::mujoco::{Data, Model, Object, Result};
use crate::robot::{FootSphere, FootState, Foothold, JOINTS, Joints, LEGS, Robot, RobotState, joint_name};

/// Ids of the robot's parts in a compiled model.
#[derive(Debug, Clone)]
pub struct Parts {
    trunk: usize,
    root_position: usize,
    root_velocity: usize,
    joints: [usize; JOINTS],
    joint_position: [usize; JOINTS],
    joint_velocity: [usize; JOINTS],
    actuators: [usize; JOINTS],
    feet: [usize; 4],
    /// The spheres that heights and velocities of the feet are those of.
    soles: [FootSphere; 4],
    ground: usize,
    /// True for each geometry of the robot.
    is_part: Vec<bool>,
    /// True for each geometry of the robot that touches the ground only after a fall.
    is_high: Vec<bool>,
}

impl Parts {
    /// Looks up all names of the robot.
    ///
    /// # Errors
    /// The model lacks a part; the error lists the names that it has.
    pub fn new(model: &Model, robot: &Robot) -> Result<Self> {
        let trunk = model.id(Object::Body, "trunk")?;
        let root = model.id(Object::Joint, "root")?;
        let joints: [usize; JOINTS] = model.ids(Object::Joint, |k| format!("{}_joint", joint_name(k)))?;
        let actuators = model.ids(Object::Actuator, joint_name)?;
        let feet: [usize; 4] = model.ids(Object::Geom, |leg| format!("{}_foot", LEGS[leg]))?;
        let sole = |leg| FootSphere::new(model, leg);
        let in_robot = |geom| model.is_below(model.geom_body(geom), trunk);
        let is_part: Vec<bool> = (0..model.count(Object::Geom)).map(in_robot).collect();
        let shanks = (2..JOINTS).step_by(3).map(|knee| model.joint_body(joints[knee]));
        let shanks: Vec<usize> = if robot.shanks_may_touch { shanks.collect() } else { Vec::new() };
        let in_shank = |geom| shanks.iter().any(|shank| model.is_below(model.geom_body(geom), *shank));
        let may_touch = |geom| feet.contains(&geom) || in_shank(geom);
        let is_high = is_part.iter().enumerate().map(|(geom, part)| *part && !may_touch(geom)).collect();
        Ok(Parts {
            trunk,
            root_position: model.joint_position_index(root),
            root_velocity: model.joint_velocity_index(root),
            joints,
            joint_position: joints.map(|joint| model.joint_position_index(joint)),
            joint_velocity: joints.map(|joint| model.joint_velocity_index(joint)),
            actuators,
            feet,
            soles: [sole(0)?, sole(1)?, sole(2)?, sole(3)?],
            ground: model.id(Object::Geom, GROUND)?,
            is_part,
            is_high,
        })
    }

    methods! {
        /// Returns the ids of the joints.
        fn joints(&self) -> [usize; JOINTS] = self.joints;
        /// Returns the body id of the trunk.
        fn trunk(&self) -> usize = self.trunk;
        /// Returns the geometry id of the ground.
        fn ground(&self) -> usize = self.ground;
        /// Returns the geometry ids of the feet.
        fn feet(&self) -> [usize; 4] = self.feet;
        /// Returns the centres of the spheres that stand for the feet after the last [`Data::step1`], world frame \[m\].
        fn foot_centres(&self, data: &Data) -> [[f64; 3]; 4] = self.soles.map(|sole| sole.centre(data));
        /// Returns true if a geometry belongs to the robot.
        fn is_part(&self, geom: usize) -> bool = self.is_part[geom];
        /// Returns the true joint angles \[rad\].
        fn joint_angles(&self, data: &Data) -> Joints = self.joint_position.map(|index| data.positions()[index]);
        /// Returns the joint rates [rad/s].
        fn joint_rates(&self, data: &Data) -> Joints = self.joint_velocity.map(|index| data.velocities()[index]);
        /// Returns the velocity of the centre of every foot, world frame [m/s].
        fn foot_velocities(&self, data: &Data) -> [[f64; 3]; 4] = self.soles.each_ref().map(|sole| sole.velocity(data));
    }

    /// Returns the velocity of the trunk: linear in the world frame [m/s], angular in the base frame [rad/s].
    pub fn trunk_velocity(&self, data: &Data) -> (Vector3<f64>, Vector3<f64>) {
        let v = &data.velocities()[self.root_velocity..];
        (Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]))
    }

    /// Returns the rotation from the base frame to the world frame.
    pub fn world_from_base(&self, data: &Data) -> UnitQuaternion<f64> {
        let q = &data.positions()[self.root_position + 3..];
        UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3]))
    }

    /// Sets the motors' torques [N·m].
    pub fn set_torques(&self, data: &mut Data, torques: &Joints) {
        let controls = data.controls_mut();
        for (actuator, torque) in self.actuators.iter().zip(torques) {
            controls[*actuator] = *torque;
        }
    }

    /// Sets the force on the centre of each foot from now on, world frame \[N\].
    pub fn set_foot_forces(&self, data: &mut Data, forces: [Vector3<f64>; 4]) {
        for (sole, force) in self.soles.into_iter().zip(forces) {
            let body = sole.body;
            let arm =
                Vector3::from(sole.centre(data)) - Vector3::from_column_slice(&data.body_centres()[3 * body..][..3]);
            let applied = &mut data.applied_forces_mut()[6 * body..][..6];
            applied[..3].copy_from_slice(force.as_slice());
            applied[3..].copy_from_slice(arm.cross(&force).as_slice());
        }
    }

    /// Adds to the trunk's velocity: linear in the world frame [m/s], angular in the base frame [rad/s].
    pub fn add_velocity(&self, data: &mut Data, linear: Vector3<f64>, angular_in_base: Vector3<f64>) {
        let start = self.root_velocity;
        let velocity = &mut data.velocities_mut()[start..start + 6];
        for axis in 0..3 {
            velocity[axis] += linear[axis];
            velocity[3 + axis] += angular_in_base[axis];
        }
    }

    /// Returns the state after the last [`Data::step1`].
    pub fn state(&self, data: &Data, ground: &Ground) -> RobotState {
        let q = &data.positions()[self.root_position..];
        let (velocity, angular_velocity_in_base) = self.trunk_velocity(data);
        let world_from_base = self.world_from_base(data);
        let position = Vector3::new(q[0], q[1], q[2]);
        let base_from_world = world_from_base.inverse();
        let gravity = data.model().gravity();
        let (footholds, velocities) = (self.footholds(data, ground), self.foot_velocities(data));
        let feet = std::array::from_fn(|leg| {
            let Foothold { height, contact } = footholds[leg];
            FootState { height, contact, velocity: velocities[leg] }
        });
        RobotState {
            height: position.z - ground.height(position.x, position.y),
            velocity_in_base: base_from_world * velocity,
            angular_velocity_in_base,
            gravity_in_base: base_from_world * Vector3::from(gravity),
            joint_angles: self.joint_angles(data),
            joint_rates: self.joint_rates(data),
            position,
            world_from_base,
            feet,
            felt_force: None,
        }
    }

    /// Returns height and contact of every foot after the last [`Data::step1`].
    pub fn footholds(&self, data: &Data, ground: &Ground) -> [Foothold; 4] {
        let mut contact = [false; 4];
        for touching in data.contacts() {
            for (foot, geom) in contact.iter_mut().zip(self.feet) {
                *foot |= touching.geoms.contains(&geom);
            }
        }
        std::array::from_fn(|leg| {
            let centre = self.soles[leg].centre(data);
            let height = centre[2] - self.soles[leg].radius_m - ground.height(centre[0], centre[1]);
            Foothold { height, contact: contact[leg] }
        })
    }

    /// Returns the id of a part that touches the ground and should not, if there is one.
    pub fn part_on_ground(&self, data: &Data) -> Option<usize> {
        data.contacts().find_map(|contact| match contact.geoms {
            [a, b] if a == self.ground && self.is_high[b] => Some(b),
            [a, b] if b == self.ground && self.is_high[a] => Some(a),
            _ => None,
        })
    }
}

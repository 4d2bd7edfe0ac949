/*! The simulated robot: PD control, latency, pushes and physics at 240 Hz within policy steps at 60 Hz.

Start with [`Scene`] (what is simulated) and [`Sim`] (one policy step at a time), then [`control`] and [`ground`].

A physics step is taken as MuJoCo's second half (forces, integration) followed by its first half (kinematics, contacts). Positions,
velocities, feet and contacts then belong to the same instant when a policy reads them, and nothing is computed twice. Contact forces exist
only between the two halves; a [`StepObserver`] sees them there.
*/

use std::sync::Arc;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

pub mod control;
mod dynamics;
pub mod ground;
pub(crate) mod last_second;
mod look;
mod parts;
pub mod scene;
pub mod terrain;

use control::{Gains, Latency, mechanical_power, squared_torque};
pub use dynamics::Dynamics;
use dynamics::Nominal;
pub use ground::{Ground, HeightField, Patches};
pub use parts::Parts;
pub use scene::{Buffers, GROUND, Scene};

use crate::config::Simulation;
use crate::mujoco::{Data, Error, Result};
use crate::robot::{Foothold, JOINTS, Joints, Losses, Robot, RobotState, joint_name};

/// The reason why the robot counts as fallen (section III-D).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Fall {
    /// The base is too low: its height above the ground \[m\].
    Low(f64),
    /// The geometry of this id, not a foot, touches the ground.
    Touch(usize),
}

/// Contact priority of feet on ground of varied friction: above that of grounds and obstacles, so that the feet's friction applies.
const FOOT_PRIORITY: i32 = 3;

/// Approximate half-length of the square that a standing robot covers \[m\].
const FOOTPRINT_M: f64 = 0.25;

/// The effort and the falls of one policy step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepSummary {
    /// `Σ|τ·q̇|`, mean over the physics steps \[W\].
    pub power_w: f64,
    /// `‖τ‖₂`, mean over the physics steps [N·m].
    pub torque_n_m: f64,
    /// `‖τ‖₂²`, mean over the physics steps [N²·m²].
    pub squared_torque: f64,
    /// The first fall within the step.
    pub fall: Option<Fall>,
}

/// Forces on the robot over the physics steps of one policy step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepForces {
    /// Motor torques in the last physics step [N·m].
    pub torques: Joints,
    /// Force on the trunk from outside, mean, world frame \[N\]: disturbances, and what touches the trunk.
    pub trunk: Vector3<f64>,
    /// Force of contacts and of what holds it on each foot, mean, world frame \[N\]; NaN where contacts are not measured.
    pub feet: [Vector3<f64>; 4],
    /// Largest contact force on any one foot \[N\].
    pub peak_foot_n: f64,
    /// Largest contact force between the robot and obstacles \[N\].
    pub peak_obstacle_n: f64,
    /// Impulse between the robot and obstacles [N·s].
    pub obstacle_impulse_n_s: f64,
    /// Time in contact with obstacles \[s\].
    pub obstacle_contact_s: f64,
}

/// Physical conditions of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Conditions {
    /// Gravity, world frame [m/s²]; tilted gravity simulates a slope.
    pub gravity: [f64; 3],
    /// Sliding friction of the ground.
    pub friction: f64,
    /// Bias of the encoders: measured minus true joint angle \[rad\].
    pub encoder_bias: Joints,
}

/// A hook into every physics step of a policy step, which may also pull the trunk and hold the feet.
pub trait StepObserver {
    /// Called before each physics step. Returns the force on the trunk's centre of mass in it, world frame \[N\];
    /// `None` leaves the force unchanged.
    fn trunk_force(&mut self, _data: &Data) -> Option<Vector3<f64>> {
        None
    }

    /// Called before each physics step. Returns the force on each foot in it, world frame \[N\]; `None` leaves the forces
    /// unchanged.
    fn foot_forces(&mut self, _data: &Data, _parts: &Parts, _ground: &Ground) -> Option<[Vector3<f64>; 4]> {
        None
    }

    /// Called between the two halves of a physics step, when contact forces exist. The state is that after the
    /// integration; contacts and forces are those that led to it.
    fn forces(&mut self, _data: &Data, _parts: &Parts, _torques: &Joints) {}

    /// Called at the end of a physics step, with the present height and contact of the feet.
    fn feet(&mut self, _feet: &[Foothold; 4]) {}
}

/// The observer that does nothing.
impl StepObserver for () {}

/// Complete state of a simulation, from which it continues with the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SimState {
    positions: Vec<f64>,
    velocities: Vec<f64>,
    warm_start: Vec<f64>,
    time_s: f64,
    latency: Latency,
    conditions: Conditions,
}

/// A simulated robot in its scene.
#[derive(Debug)]
pub struct Sim {
    data: Data,
    robot: Arc<Robot>,
    parts: Parts,
    ground: Ground,
    nominal: Nominal,
    gains: Gains,
    latency: Latency,
    conditions: Conditions,
    substeps: usize,
    fall_height_m: f64,
    start: Vec<f64>,
    /// Positions as the last [`Data::step1`] found them. It normalises quaternions, which is not idempotent to the last
    /// bit, so resuming from the positions after it would not give the same bits.
    unnormalised: Vec<f64>,
}

impl Sim {
    /// Compiles the scene and places the robot in its starting pose. It counts as fallen below `fall_height_m` \[m\],
    /// unless its description states another height.
    ///
    /// # Errors
    /// The scene does not compile, the model lacks a part of the robot, or MuJoCo fails.
    pub fn new(scene: &Scene, config: &Simulation, fall_height_m: f64) -> Result<Self> {
        let mut model = scene.compile()?;
        let parts = Parts::new(&model, &scene.robot)?;
        if scene.ground.patches().is_some() {
            // Where friction differs by place, each foot carries that of its own place.
            parts.feet().into_iter().for_each(|foot| model.set_priority(foot, FOOT_PRIORITY));
        }
        if scene.extra_mass_kg != 0.0 {
            model.add_mass(parts.trunk(), scene.extra_mass_kg)?;
        }
        let Losses { friction_n_m, damping_n_m_s_per_rad } = scene.robot.losses;
        for joint in parts.joints() {
            model.set_losses(joint, friction_n_m, damping_n_m_s_per_rad);
        }
        let mut start = scene.robot.stand.clone();
        start[2] += scene.ground.height(start[0], start[1]);
        let conditions =
            Conditions { gravity: model.gravity(), friction: scene::FRICTION[0], encoder_bias: [0.0; JOINTS] };
        let data = Data::new(model)?;
        Ok(Sim {
            nominal: Nominal::new(&data, &parts, config, scene.robot.losses),
            data,
            parts,
            robot: Arc::clone(&scene.robot),
            ground: scene.ground.clone(),
            gains: Gains::new(config),
            latency: Latency::new(config.latency_s, config.timestep_s(), [0.0; JOINTS]),
            conditions,
            substeps: config.substeps(),
            fall_height_m: scene.robot.fall_height_m.unwrap_or(fall_height_m),
            unnormalised: start.clone(),
            start,
        })
    }

    /// Gives the robot other dynamics from the next [`Sim::reset`] or [`Sim::restore`] on.
    pub(crate) fn set_dynamics(&mut self, dynamics: &Dynamics) -> Result<()> {
        (self.gains, self.latency) = self.nominal.deviate(&mut self.data, &self.parts, dynamics)?;
        Ok(())
    }

    /// Moves the robot's start to a place on the ground, world frame \[m\], from the next [`Sim::reset`] on.
    pub(crate) fn set_start(&mut self, [x, y]: [f64; 2]) {
        let above = self.start[2] - self.ground.height(self.start[0], self.start[1]);
        self.start[..3].copy_from_slice(&[x, y, above + self.ground.height(x, y)]);
    }

    /// Returns the robot to its start, at rest, holding `target` \[rad\].
    ///
    /// # Errors
    /// MuJoCo fails in the new state.
    pub fn reset(&mut self, conditions: Conditions, target: &Joints) -> Result<()> {
        self.data.reset()?;
        self.data.positions_mut()[..self.start.len()].copy_from_slice(&self.start);
        self.latency.reset(*target);
        self.apply(conditions);
        self.refresh()
    }

    /// Sets the robot on its feet at its present place and heading, at rest, holding `target` \[rad\]; obstacles stay
    /// as they are. A robot that has left the ground is set at its edge.
    ///
    /// # Errors
    /// MuJoCo fails in the new state.
    pub fn set_on_feet(&mut self, target: &Joints) -> Result<()> {
        let state = self.parts.state(&self.data, &self.ground);
        let (_, _, yaw) = state.roll_pitch_yaw();
        let [x, y] = self.ground.nearest([state.position.x, state.position.y], FOOTPRINT_M);
        let about = [-FOOTPRINT_M, 0.0, FOOTPRINT_M];
        let heights = about.iter().flat_map(|dx| about.map(|dy| self.ground.height(x + dx, y + dy)));
        let ground = heights.fold(f64::NEG_INFINITY, f64::max);
        let flat = self.start[2] - self.ground.height(self.start[0], self.start[1]);
        let (sin, cos) = (0.5 * yaw).sin_cos();
        let positions = &mut self.data.positions_mut()[..self.start.len()];
        positions.copy_from_slice(&self.start);
        positions[..7].copy_from_slice(&[x, y, ground + flat, cos, 0.0, 0.0, sin]);
        // One velocity fewer than positions: the quaternion's fourth number.
        let moving = self.start.len() - 1;
        self.data.velocities_mut()[..moving].fill(0.0);
        self.latency.reset(*target);
        self.refresh()
    }

    /// Gives each foot the friction of the ground under its last known position.
    fn feel_ground(&mut self) {
        let Some(patches) = self.ground.patches() else { return };
        for (foot, [x, y, _]) in self.parts.feet().into_iter().zip(self.parts.foot_centres(&self.data)) {
            let friction = patches.at(x, y);
            self.data.set_sliding_friction(foot, friction);
        }
    }

    /// Repeats the first half of a physics step, so that changes through [`Sim::data_mut`] take effect, such as moved
    /// bodies or cut tendons.
    ///
    /// # Errors
    /// MuJoCo fails in the changed state.
    pub fn refresh(&mut self) -> Result<()> {
        self.feel_ground();
        self.unnormalised.clear();
        self.unnormalised.extend_from_slice(self.data.positions());
        self.data.step1()
    }

    fn apply(&mut self, conditions: Conditions) {
        self.data.set_gravity(conditions.gravity);
        self.data.set_sliding_friction(self.parts.ground(), conditions.friction);
        self.conditions = conditions;
    }

    /// Runs one policy step towards joint targets \[rad\].
    ///
    /// # Errors
    /// A target is not finite, or MuJoCo fails; then reset the simulation before the next step.
    pub fn step(&mut self, target: &Joints, observer: &mut impl StepObserver) -> Result<StepSummary> {
        if let Some(joint) = target.iter().position(|angle| !angle.is_finite()) {
            let what = format!("the joint target of {}", joint_name(joint));
            return Err(Error::Input { what, found: target[joint].to_string() });
        }
        let mut summary = StepSummary { power_w: 0.0, torque_n_m: 0.0, squared_torque: 0.0, fall: None };
        let limits = self.robot.torque_limits;
        for _ in 0..self.substeps {
            let acting = self.latency.delay(target);
            let rates = self.parts.joint_rates(&self.data);
            let torques = self.gains.torques(&acting, &self.measured_angles(), &rates, &limits);
            self.parts.set_torques(&mut self.data, &torques);
            if let Some(force) = observer.trunk_force(&self.data) {
                self.set_trunk_force(force);
            }
            if let Some(forces) = observer.foot_forces(&self.data, &self.parts, &self.ground) {
                self.parts.set_foot_forces(&mut self.data, forces);
            }
            self.data.step2()?;
            observer.forces(&self.data, &self.parts, &torques);
            self.refresh()?;
            observer.feet(&self.parts.footholds(&self.data, &self.ground));
            let squared = squared_torque(&torques);
            summary.power_w += mechanical_power(&torques, &rates);
            summary.torque_n_m += squared.sqrt();
            summary.squared_torque += squared;
            summary.fall = summary.fall.or_else(|| self.fall());
        }
        let substeps = self.substeps as f64;
        summary.power_w /= substeps;
        summary.torque_n_m /= substeps;
        summary.squared_torque /= substeps;
        Ok(summary)
    }

    /// Returns the joint angles as the encoders read them \[rad\].
    pub(crate) fn measured_angles(&self) -> Joints {
        let angles = self.parts.joint_angles(&self.data);
        std::array::from_fn(|joint| angles[joint] + self.conditions.encoder_bias[joint])
    }

    /// Returns the present state, with joint angles as the encoders read them.
    pub fn state(&self) -> RobotState {
        let mut state = self.parts.state(&self.data, &self.ground);
        state.joint_angles = self.measured_angles();
        state
    }

    /// Adds to the trunk's velocity at this instant: forward and left in the heading frame [m/s], and about the base's three
    /// axes [rad/s].
    ///
    /// # Errors
    /// MuJoCo fails with the new velocity.
    pub fn push(&mut self, [forward, left]: [f64; 2], angular: [f64; 3]) -> Result<()> {
        let linear = self.state().heading() * Vector3::new(forward, left, 0.0);
        self.parts.add_velocity(&mut self.data, linear, Vector3::from(angular));
        self.refresh()
    }

    /// Sets the force that acts on the trunk's centre of mass from now on, world frame \[N\].
    pub(crate) fn set_trunk_force(&mut self, force: Vector3<f64>) {
        let start = 6 * self.parts.trunk();
        self.data.applied_forces_mut()[start..start + 3].copy_from_slice(force.as_slice());
    }

    fn fall(&self) -> Option<Fall> {
        if let Some(geom) = self.parts.part_on_ground(&self.data) {
            return Some(Fall::Touch(geom));
        }
        let trunk = &self.data.body_positions()[3 * self.parts.trunk()..];
        let height = trunk[2] - self.ground.height(trunk[0], trunk[1]);
        (height < self.fall_height_m).then_some(Fall::Low(height))
    }

    /// Describes a fall, such as "the base sank to 0.19 m" or "RL_calf touched the ground".
    pub fn describe(&self, fall: Fall) -> String {
        match fall {
            Fall::Low(height) => format!("the base sank to {height:.2} m"),
            Fall::Touch(geom) => {
                let (model, joints) = (self.data.model(), self.parts.joints());
                let moved_by = |joint: &usize| model.is_below(model.geom_body(geom), model.joint_body(joints[*joint]));
                // From the shanks up.
                let part = (0..JOINTS).rev().find(moved_by).map_or("trunk".to_owned(), joint_name);
                format!("{part} touched the ground")
            }
        }
    }

    methods! {
        /// Returns the physics, for recorders and metrics.
        fn data(&self) -> &Data = &self.data;
        /// Returns the physics to be changed, for scenarios that move obstacles or inject faults.
        fn data_mut(&mut self) -> &mut Data = &mut self.data;
        /// Returns the robot.
        fn robot(&self) -> &Arc<Robot> = &self.robot;
        /// Returns the ids of the robot's parts in the model.
        fn parts(&self) -> &Parts = &self.parts;
        /// Returns the ground.
        fn ground(&self) -> &Ground = &self.ground;
        /// Returns the duration of a policy step \[s\].
        fn policy_period_s(&self) -> f64 = self.substeps as f64 * self.data.model().timestep_s();
    }

    /// Returns the state from which the simulation continues exactly.
    pub fn save(&self) -> SimState {
        let (positions, velocities) = (self.unnormalised.clone(), self.data.velocities().to_vec());
        let (warm_start, latency) = (self.data.warm_start().to_vec(), self.latency.clone());
        SimState { positions, velocities, warm_start, time_s: self.data.time_s(), latency, conditions: self.conditions }
    }

    /// Restores a saved state.
    ///
    /// # Errors
    /// The state belongs to another model, or MuJoCo fails in it.
    pub fn restore(&mut self, state: &SimState) -> Result<()> {
        let model = self.data.model();
        if state.positions.len() != model.nq()
            || state.velocities.len() != model.nv()
            || state.warm_start.len() != model.nv()
            || !self.latency.fits(&state.latency)
        {
            let message = "it belongs to another model or latency".into();
            return Err(Error::Load { what: "a saved state".into(), message });
        }
        self.data.reset()?;
        self.apply(state.conditions);
        self.data.positions_mut().copy_from_slice(&state.positions);
        self.data.velocities_mut().copy_from_slice(&state.velocities);
        self.data.warm_start_mut().copy_from_slice(&state.warm_start);
        self.data.set_time_s(state.time_s);
        self.latency = state.latency.clone();
        self.refresh()
    }
}

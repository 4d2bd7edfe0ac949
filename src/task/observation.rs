/*! The observation of section III-A, `o_t = {ô_{t−1}, a_{t−1}, ô_t, v_x*, v_z*, ω_y*} ∈ R^83`.

[`LAYOUT`] is the one description of it: packing, scaling, the policy file and the tests all follow it. Vectors appear
in the paper's axes (left, up, forward), quantities in the units of Table I; `a_{t−1}` is the joint target \[rad\] that
was last given to the PD controller.
*/

use serde::{Deserialize, Serialize};

use super::episode::Command;
use crate::config::Config;
use crate::go1::{JOINT_COUNT, Joints, RobotState, paper_axes, same_in_every_leg};

/// A physical quantity of the observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// `y`: base height above the ground \[m\].
    BaseHeight,
    /// `g_x, g_y, g_z`: gravity in the base frame, paper's axes [m/s²].
    LocalGravity,
    /// `q_0…11` \[rad\].
    JointAngles,
    /// `v_x, v_y, v_z`: velocity in the base frame, paper's axes [m/s].
    LocalVelocity,
    /// `ω_x, ω_y, ω_z`: angular velocity in the base frame, paper's axes [rad/s].
    LocalAngularVelocity,
    /// `q̇_0…11` [rad/s].
    JointRates,
    /// `a_{t−1}`: the last joint targets \[rad\].
    JointTargets,
    /// `v_x*, v_z*, ω_y*`: left [m/s], forward [m/s], yaw rate [rad/s].
    Command,
}

impl Quantity {
    /// How many numbers it has.
    pub const fn length(self) -> usize {
        match self {
            Quantity::BaseHeight => 1,
            Quantity::LocalGravity | Quantity::LocalVelocity | Quantity::LocalAngularVelocity | Quantity::Command => 3,
            Quantity::JointAngles | Quantity::JointRates | Quantity::JointTargets => JOINT_COUNT,
        }
    }

    /// Units of its numbers.
    pub const fn unit(self) -> &'static str {
        match self {
            Quantity::BaseHeight => "m",
            Quantity::LocalGravity => "m/s^2",
            Quantity::JointAngles | Quantity::JointTargets => "rad",
            Quantity::LocalVelocity => "m/s",
            Quantity::LocalAngularVelocity | Quantity::JointRates => "rad/s",
            Quantity::Command => "m/s, m/s, rad/s",
        }
    }
}

/// `ô`, the reduced observation of Table I.
pub const REDUCED: [Quantity; 6] = [
    Quantity::BaseHeight,
    Quantity::LocalGravity,
    Quantity::JointAngles,
    Quantity::LocalVelocity,
    Quantity::LocalAngularVelocity,
    Quantity::JointRates,
];

/// Length of `ô`.
pub const REDUCED_LENGTH: usize = total_length(&REDUCED);

/// A stretch of the observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Block {
    /// What it is.
    pub quantity: Quantity,
    /// Policy steps ago that it was measured: 1 for `ô_{t−1}` and `a_{t−1}`, else 0.
    pub age: u32,
}

const fn block(quantity: Quantity, age: u32) -> Block {
    Block { quantity, age }
}

/// The whole observation.
pub const LAYOUT: [Block; 14] = [
    block(REDUCED[0], 1),
    block(REDUCED[1], 1),
    block(REDUCED[2], 1),
    block(REDUCED[3], 1),
    block(REDUCED[4], 1),
    block(REDUCED[5], 1),
    block(Quantity::JointTargets, 1),
    block(REDUCED[0], 0),
    block(REDUCED[1], 0),
    block(REDUCED[2], 0),
    block(REDUCED[3], 0),
    block(REDUCED[4], 0),
    block(REDUCED[5], 0),
    block(Quantity::Command, 0),
];

/// Length of the observation: `2 · 34 + 12 + 3`.
pub const LENGTH: usize = 2 * REDUCED_LENGTH + JOINT_COUNT + 3;

const _: () = assert!(REDUCED_LENGTH == 34 && LENGTH == 83);

const fn total_length(quantities: &[Quantity]) -> usize {
    let (mut sum, mut k) = (0, 0);
    while k < quantities.len() {
        sum += quantities[k].length();
        k += 1;
    }
    sum
}

/// `ô_t` in the units of Table I.
pub type Reduced = [f64; REDUCED_LENGTH];

/// The observation in physical units.
pub type Observation = [f64; LENGTH];

/// Table I.
pub fn reduced(state: &RobotState) -> Reduced {
    let mut values = [0.0; REDUCED_LENGTH];
    let mut packer = Packer { values: &mut values, next: 0 };
    packer.put(&[state.height]);
    packer.put(&paper_axes(state.gravity_in_base));
    packer.put(&state.joint_angles);
    packer.put(&paper_axes(state.velocity_in_base));
    packer.put(&paper_axes(state.angular_velocity_in_base));
    packer.put(&state.joint_rates);
    values
}

/// `o_t`.
pub fn pack(previous: &Reduced, last_target: &Joints, current: &Reduced, command: &Command) -> Observation {
    let mut values = [0.0; LENGTH];
    let mut packer = Packer { values: &mut values, next: 0 };
    packer.put(previous);
    packer.put(last_target);
    packer.put(current);
    packer.put(&[command.left, command.forward, command.yaw]);
    values
}

struct Packer<'a> {
    values: &'a mut [f64],
    next: usize,
}

impl Packer<'_> {
    fn put(&mut self, block: &[f64]) {
        self.values[self.next..self.next + block.len()].copy_from_slice(block);
        self.next += block.len();
    }
}

/// What the networks see: `(raw − offset) · scale`, fixed numbers that travel with the policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Normaliser {
    /// Shape (83), in the observation's units.
    pub offset: Vec<f64>,
    /// Shape (83), in the inverse of the observation's units.
    pub scale: Vec<f64>,
}

impl Normaliser {
    /// The scaling that the configuration states, laid out by [`LAYOUT`].
    pub fn new(config: &Config) -> Self {
        let pose = same_in_every_leg(config.action.nominal_pose_rad);
        let scales = &config.observation;
        let (mut offset, mut scale) = (Vec::with_capacity(LENGTH), Vec::with_capacity(LENGTH));
        for block in LAYOUT {
            let length = block.quantity.length();
            let (offsets, factor) = match block.quantity {
                Quantity::BaseHeight => (vec![config.reward.base_height_m], scales.height_scale),
                Quantity::LocalGravity => (vec![0.0; length], scales.gravity_scale),
                Quantity::JointAngles => (pose.to_vec(), scales.joint_angle_scale),
                Quantity::LocalVelocity => (vec![0.0; length], scales.velocity_scale),
                Quantity::LocalAngularVelocity => (vec![0.0; length], scales.angular_velocity_scale),
                Quantity::JointRates => (vec![0.0; length], scales.joint_rate_scale),
                // The network sees its own last output.
                Quantity::JointTargets => (pose.to_vec(), 1.0 / config.action.scale_rad),
                Quantity::Command => (vec![0.0; length], 1.0),
            };
            offset.extend(offsets);
            scale.extend(std::iter::repeat_n(factor, length));
        }
        Normaliser { offset, scale }
    }

    /// Scales an observation; both slices of the same length.
    pub fn apply(&self, raw: &[f64], normalised: &mut [f32]) {
        for (k, value) in normalised.iter_mut().enumerate() {
            *value = ((raw[k] - self.offset[k]) * self.scale[k]) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::go1::FootState;
    use nalgebra::{UnitQuaternion, Vector3};

    fn state() -> RobotState {
        RobotState {
            position: Vector3::new(7.0, 8.0, 9.0),
            world_from_base: UnitQuaternion::identity(),
            height: 0.25,
            velocity_in_base: Vector3::new(1.0, 2.0, 3.0),
            angular_velocity_in_base: Vector3::new(4.0, 5.0, 6.0),
            gravity_in_base: Vector3::new(-0.1, -0.2, -9.8),
            joint_angles: std::array::from_fn(|k| k as f64),
            joint_rates: std::array::from_fn(|k| 100.0 + k as f64),
            feet: [FootState::default(); 4],
        }
    }

    #[test]
    fn reduced_observation_follows_table_one_in_the_papers_axes() {
        let values = reduced(&state());
        assert_eq!(values[0], 0.25);
        assert_eq!(values[1..4], [-0.2, -9.8, -0.1]);
        assert_eq!(values[4..7], [0.0, 1.0, 2.0]);
        assert_eq!(values[16..19], [2.0, 3.0, 1.0]);
        assert_eq!(values[19..22], [5.0, 6.0, 4.0]);
        assert_eq!(values[22], 100.0);
    }

    #[test]
    fn layout_and_packing_agree() {
        let lengths: usize = LAYOUT.iter().map(|block| block.quantity.length()).sum();
        assert_eq!(lengths, LENGTH);
        let command = Command { forward: 0.5, left: 0.25, yaw: -0.125 };
        let values = pack(&[1.0; 34], &[2.0; 12], &[3.0; 34], &command);
        let mut start = 0;
        for block in LAYOUT {
            let expected = match (block.quantity, block.age) {
                (Quantity::JointTargets, _) => vec![2.0; 12],
                (Quantity::Command, _) => vec![0.25, 0.5, -0.125],
                (quantity, age) => vec![if age == 1 { 1.0 } else { 3.0 }; quantity.length()],
            };
            assert_eq!(values[start..start + expected.len()], expected, "{block:?}");
            start += expected.len();
        }
    }

    #[test]
    fn nominal_pose_at_desired_height_and_rest_is_zero_but_for_gravity() {
        let config = Config::load("compliant").unwrap();
        let pose = same_in_every_leg(config.action.nominal_pose_rad);
        let mut rest = state();
        (rest.height, rest.joint_angles, rest.joint_rates) = (0.31, pose, [0.0; 12]);
        (rest.velocity_in_base, rest.angular_velocity_in_base) = (Vector3::zeros(), Vector3::zeros());
        rest.gravity_in_base = Vector3::new(0.0, 0.0, -9.81);
        let current = reduced(&rest);
        let mut seen = [0.0; LENGTH];
        Normaliser::new(&config).apply(&pack(&current, &pose, &current, &Command::default()), &mut seen);
        for (index, value) in seen.iter().enumerate() {
            let expected = if index == 2 || index == 46 + 2 { -1.0 } else { 0.0 };
            assert!((value - expected).abs() < 1e-6, "element {index} is {value}");
        }
    }
}

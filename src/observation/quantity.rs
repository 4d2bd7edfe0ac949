/*! Quantities that can be observed: the name, unit, kind and measurement of each.

Vectors are in the base frame, (forward, left, up). The layout selects their elements, order and signs; the paper has
(left, up, forward). Quantities that no robot measures are privileged: they are for the critic of training alone.
*/

use std::f64::consts::TAU;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::observer::Moment;
use crate::robot::{JOINTS, Joints};

/// A physical quantity that can be observed; vectors are in the base frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Height of the base above the ground \[m\]; `y` of the paper.
    BaseHeight,
    /// Gravity [m/s²]; `g` of the paper.
    Gravity,
    /// Direction of gravity, a unit vector.
    ProjectedGravity,
    /// Joint angles \[rad\]; `q` of the paper.
    JointAngles,
    /// Joint angles minus the nominal pose \[rad\].
    JointOffsets,
    /// Joint rates [rad/s]; `q̇` of the paper.
    JointRates,
    /// Velocity of the base [m/s]; `v` of the paper.
    BaseVelocity,
    /// Angular velocity of the base [rad/s]; `ω` of the paper.
    AngularVelocity,
    /// The network's last outputs, clipped, not scaled; zero at first.
    LastAction,
    /// Force on the trunk from outside that the robot feels in its joints, forward and left in the heading frame, mean over the last
    /// policy step, between ± 100 \[N\]; zero where it is not felt.
    FeltForce,
    /// The last joint targets \[rad\]; the nominal pose at first. `a_{t−1}` of the paper.
    LastTarget,
    /// Commanded velocity: forward [m/s], left [m/s], yaw rate [rad/s].
    Command,
    /// Clock sin 2π(f·t + phase), for each of `phases`.
    ClockSin,
    /// Clock cos 2π(f·t + phase), for each of `phases`.
    ClockCos,
    /// The constants `values`.
    Constant,
    /// Privileged: contact force on each foot, and the force that holds it, mean over the last policy step \[N\].
    FootForces,
    /// Privileged: height of each foot's lowest point above the ground under it \[m\].
    FootHeights,
    /// Privileged: sliding friction of the ground.
    Friction,
    /// Privileged: encoder bias of each joint \[rad\].
    EncoderBias,
    /// Privileged: pull on the trunk in the coming policy step \[N\].
    Pull,
    /// Privileged: push at the start of the coming policy step, a change of the trunk's velocity [m/s].
    Push,
    /// Privileged: mass that the trunk has beyond the robot's description \[kg\].
    TrunkMass,
    /// Privileged: displacement of the trunk's centre of mass from the robot's description \[m\].
    TrunkOffset,
    /// Privileged: delay of the joint target \[s\].
    Latency,
}

/// Largest felt force that a policy observes on each axis \[N\]: a push within one step would be several hundred.
pub const MOST_FELT_N: f64 = 100.0;

/// What the simulator knows and no robot measures: only a critic may observe it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Privileged {
    /// Contact force on each foot, and the force that holds it, mean over the last policy step, base frame \[N\].
    pub foot_forces: [Vector3<f64>; 4],
    /// Sliding friction of the ground.
    pub friction: f64,
    /// Bias of the encoders: measured minus true joint angle \[rad\].
    pub encoder_bias: Joints,
    /// Pull on the trunk in the coming policy step, base frame \[N\].
    pub pull: Vector3<f64>,
    /// Change of the trunk's velocity at the start of the coming policy step, base frame [m/s].
    pub push: Vector3<f64>,
    /// Mass that the trunk has beyond the robot's description \[kg\].
    pub trunk_mass_kg: f64,
    /// Displacement of the trunk's centre of mass from the robot's description, base frame \[m\].
    pub trunk_offset_m: Vector3<f64>,
    /// Delay of the joint target \[s\].
    pub latency_s: f64,
}

/// The kind of a quantity's numbers, which decides their names and their mirror images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// A scalar: one number, which a mirror leaves unchanged.
    Scalar,
    /// A polar vector: a mirror reverses its left element.
    Polar,
    /// An axial vector: a mirror keeps its left element and reverses the others.
    Axial,
    /// A command: forward, left, yaw rate.
    Command,
    /// Joint values: one number for each joint.
    Joints,
    /// A clock: one number for each phase that the layout lists.
    Clock,
    /// The constants that the layout lists.
    Constant,
    /// One number for each foot.
    Feet,
    /// A polar vector for each foot.
    FootVectors,
}

impl Quantity {
    /// Returns kind, name and unit (three units if the elements differ).
    pub(super) fn about(self) -> (Kind, &'static str, &'static str) {
        match self {
            Quantity::BaseHeight => (Kind::Scalar, "base height", "m"),
            Quantity::Gravity => (Kind::Polar, "gravity", "m/s^2"),
            Quantity::ProjectedGravity => (Kind::Polar, "direction of gravity", "1"),
            Quantity::JointAngles => (Kind::Joints, "angle", "rad"),
            Quantity::JointOffsets => (Kind::Joints, "angle from nominal", "rad"),
            Quantity::JointRates => (Kind::Joints, "rate", "rad/s"),
            Quantity::BaseVelocity => (Kind::Polar, "velocity", "m/s"),
            Quantity::AngularVelocity => (Kind::Axial, "angular velocity", "rad/s"),
            Quantity::FeltForce => (Kind::Polar, "felt force", "N"),
            Quantity::LastAction => (Kind::Joints, "output", "1"),
            Quantity::LastTarget => (Kind::Joints, "target", "rad"),
            Quantity::Command => (Kind::Command, "commanded", "m/s, m/s, rad/s"),
            Quantity::ClockSin => (Kind::Clock, "sine of a clock", "1"),
            Quantity::ClockCos => (Kind::Clock, "cosine of a clock", "1"),
            Quantity::Constant => (Kind::Constant, "constant", "1"),
            Quantity::FootForces => (Kind::FootVectors, "force", "N"),
            Quantity::FootHeights => (Kind::Feet, "height", "m"),
            Quantity::Friction => (Kind::Scalar, "friction", "1"),
            Quantity::EncoderBias => (Kind::Joints, "encoder bias", "rad"),
            Quantity::Pull => (Kind::Polar, "pull", "N"),
            Quantity::Push => (Kind::Polar, "push", "m/s"),
            Quantity::TrunkMass => (Kind::Scalar, "additional trunk mass", "kg"),
            Quantity::TrunkOffset => (Kind::Polar, "offset of the trunk's centre of mass", "m"),
            Quantity::Latency => (Kind::Scalar, "latency", "s"),
        }
    }

    /// Returns true if only the simulator knows the quantity, so that policies cannot observe it.
    pub fn is_privileged(self) -> bool {
        use Quantity::{EncoderBias, FootForces, FootHeights, Friction, Latency, Pull, Push, TrunkMass, TrunkOffset};
        matches!(
            self,
            FootForces | FootHeights | Friction | EncoderBias | Pull | Push | TrunkMass | TrunkOffset | Latency
        )
    }

    /// Measures this quantity into `out`, a slice of its width. `axes` selects the elements and signs of a vector;
    /// `values` are the phases of a clock or the values of a constant; `order` is the policy's order of joints.
    pub(super) fn measure(
        self,
        axes: &[(usize, f64)],
        (frequency_hz, values): (f64, &[f64]),
        order: &[usize; JOINTS],
        now: &Moment<'_>,
        out: &mut [f64],
    ) {
        let (state, known) = (now.state, now.privileged);
        let mut vector = |[forward, left, up]: [f64; 3]| {
            out.iter_mut().zip(axes).for_each(|(out, (axis, sign))| *out = sign * [forward, left, up][*axis]);
        };
        match self {
            Quantity::BaseHeight => out[0] = state.height,
            Quantity::Gravity => vector(state.gravity_in_base.into()),
            Quantity::ProjectedGravity => vector(state.gravity_in_base.normalize().into()),
            Quantity::BaseVelocity => vector(state.velocity_in_base.into()),
            Quantity::AngularVelocity => vector(state.angular_velocity_in_base.into()),
            Quantity::FeltForce => {
                let [forward, left] = state.felt_force.unwrap_or_default();
                vector([forward, left, 0.0].map(|force| force.clamp(-MOST_FELT_N, MOST_FELT_N)));
            }
            Quantity::Command => vector([now.command.forward, now.command.left, now.command.yaw]),
            Quantity::JointAngles => reorder(&state.joint_angles, order, out),
            Quantity::JointOffsets => {
                let offsets = std::array::from_fn(|joint| state.joint_angles[joint] - now.nominal[joint]);
                reorder(&offsets, order, out);
            }
            Quantity::JointRates => reorder(&state.joint_rates, order, out),
            // In the policy's order already.
            Quantity::LastAction => out.copy_from_slice(now.last_action),
            Quantity::LastTarget => reorder(now.last_target, order, out),
            Quantity::ClockSin | Quantity::ClockCos => {
                let wave = if self == Quantity::ClockSin { f64::sin } else { f64::cos };
                let turns = frequency_hz * now.time_s;
                let phases = out.iter_mut().zip(values);
                phases.for_each(|(out, phase)| *out = wave(TAU * (turns + phase).fract()));
            }
            Quantity::Constant => out.copy_from_slice(values),
            Quantity::FootForces => {
                for (out, force) in out.chunks_exact_mut(axes.len()).zip(known.foot_forces) {
                    out.iter_mut().zip(axes).for_each(|(out, (axis, sign))| *out = sign * force[*axis]);
                }
            }
            Quantity::FootHeights => out.copy_from_slice(&state.feet.map(|foot| foot.height)),
            Quantity::Friction => out[0] = known.friction,
            Quantity::EncoderBias => reorder(&known.encoder_bias, order, out),
            Quantity::Pull => vector(known.pull.into()),
            Quantity::Push => vector(known.push.into()),
            Quantity::TrunkMass => out[0] = known.trunk_mass_kg,
            Quantity::TrunkOffset => vector(known.trunk_offset_m.into()),
            Quantity::Latency => out[0] = known.latency_s,
        }
    }
}

/// Reorders joint values from Supple's order to the policy's.
fn reorder(joints: &Joints, order: &[usize; JOINTS], out: &mut [f64]) {
    out.iter_mut().zip(order).for_each(|(out, joint)| *out = joints[*joint]);
}

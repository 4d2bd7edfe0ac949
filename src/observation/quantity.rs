/*! Quantities that can be observed: the name, unit, kind and measurement of each.

Vectors are in the base frame, (forward, left, up). The layout selects their elements, order and signs; the paper has
(left, up, forward).
*/

use std::f64::consts::TAU;

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
            Quantity::LastAction => (Kind::Joints, "output", "1"),
            Quantity::LastTarget => (Kind::Joints, "target", "rad"),
            Quantity::Command => (Kind::Command, "commanded", "m/s, m/s, rad/s"),
            Quantity::ClockSin => (Kind::Clock, "sine of a clock", "1"),
            Quantity::ClockCos => (Kind::Clock, "cosine of a clock", "1"),
            Quantity::Constant => (Kind::Constant, "constant", "1"),
        }
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
        let state = now.state;
        let mut vector = |[forward, left, up]: [f64; 3]| {
            out.iter_mut().zip(axes).for_each(|(out, (axis, sign))| *out = sign * [forward, left, up][*axis]);
        };
        match self {
            Quantity::BaseHeight => out[0] = state.height,
            Quantity::Gravity => vector(state.gravity_in_base.into()),
            Quantity::ProjectedGravity => vector(state.gravity_in_base.normalize().into()),
            Quantity::BaseVelocity => vector(state.velocity_in_base.into()),
            Quantity::AngularVelocity => vector(state.angular_velocity_in_base.into()),
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
        }
    }
}

/// Reorders joint values from Supple's order to the policy's.
fn reorder(joints: &Joints, order: &[usize; JOINTS], out: &mut [f64]) {
    out.iter_mut().zip(order).for_each(|(out, joint)| *out = joints[*joint]);
}

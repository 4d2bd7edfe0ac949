/*! Quantities that can be observed: the name, unit, kind and measurement of each.

Vectors are in the base frame, (forward, left, up). The layout selects their elements, order and signs; the paper has
(left, up, forward). Quantities that no robot measures are privileged: they are for the critic of training alone.
*/

use std::f64::consts::TAU;
use std::fmt;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::observer::ObservationInput;
use crate::robot::{JOINTS, Joints};
use crate::util::yaml;

/// Defines [`Quantity`]: what each is, its kind, the name and the unit of its numbers (three units if they differ), and who
/// observes it.
macro_rules! quantities {
    ($(
        $(#[doc = $what:literal])+ $(#[serde(rename = $key:literal)])?
        $quantity:ident: $kind:ident, $name:literal, $unit:literal, $seen_by:ident;
    )+) => {
        /// A physical quantity that can be observed; vectors are in the base frame. docs/quantities.md has a table of them.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Quantity {
            $($(#[doc = $what])+ #[doc = concat!("\n\nUnit: ", $unit, ".")] $(#[serde(rename = $key)])? $quantity,)+
        }

        impl Quantity {
            /// All quantities.
            pub const ALL: &[Quantity] = &[$(Quantity::$quantity),+];

            /// Returns the description of the quantity.
            pub(super) fn about(self) -> About {
                match self {
                    $(Quantity::$quantity => About {
                        kind: Kind::$kind,
                        name: $name,
                        unit: $unit,
                        seen_by: SeenBy::$seen_by,
                        what: concat!($($what),+),
                    },)+
                }
            }
        }
    };
}

quantities! {
    /// Height of the base above the ground; `y` of the paper.
    BaseHeight: Scalar, "base height", "m", Policy;
    /// Gravity; `g` of the paper.
    Gravity: Polar, "gravity", "m/s^2", Policy;
    /// Direction of gravity, a unit vector.
    ProjectedGravity: Polar, "direction of gravity", "1", Policy;
    /// Joint angles; `q` of the paper.
    JointAngles: Joints, "angle", "rad", Policy;
    /// Joint angles minus the nominal pose.
    JointOffsets: Joints, "angle from nominal", "rad", Policy;
    /// Joint rates; `q̇` of the paper.
    JointRates: Joints, "rate", "rad/s", Policy;
    /// Velocity of the base; `v` of the paper.
    BaseVelocity: Polar, "velocity", "m/s", Policy;
    /// Angular velocity of the base; `ω` of the paper.
    AngularVelocity: Axial, "angular velocity", "rad/s", Policy;
    /// The network's last outputs, clipped, not scaled; zero at first.
    LastAction: Joints, "output", "1", Policy;
    /// Force on the trunk from outside that the robot feels in its joints, forward and left, mean over the last policy step,
    /// between ± 100 N; zero where it is not felt.
    FeltForce: Polar, "felt force", "N", Policy;
    /// The last joint targets; the nominal pose at first. `a_{t−1}` of the paper.
    LastTarget: Joints, "target", "rad", Policy;
    /// Commanded compliance; zero without one.
    CommandedCompliance: Scalar, "commanded compliance", "m/s/N", Policy;
    /// Commanded compliance times felt force: the velocity by which the robot is to give way, forward and left.
    CommandedYield: Polar, "commanded yield", "m/s", Policy;
    /// Commanded velocity: forward, left, yaw rate.
    Command: Command, "commanded", "m/s, m/s, rad/s", Policy;
    /// Clock sin 2π(f·t + phase), for each of `phases`.
    ClockSin: Clock, "sine of a clock", "1", Policy;
    /// Clock cos 2π(f·t + phase), for each of `phases`.
    ClockCos: Clock, "cosine of a clock", "1", Policy;
    /// The constants `values`.
    Constant: Constant, "constant", "1", Policy;
    /// Contact force on each foot, and the force that holds it, mean over the last policy step.
    FootForces: FootVectors, "force", "N", Critic;
    /// Height of each foot's lowest point above the ground under it.
    FootHeights: Feet, "height", "m", Critic;
    /// Sliding friction of the ground.
    Friction: Scalar, "friction", "1", Critic;
    /// Encoder bias of each joint: measured minus true angle.
    EncoderBias: Joints, "encoder bias", "rad", Critic;
    /// Force on the trunk in the coming policy step: `pull` in files, `Quantity::TrunkForce` in the library.
    #[serde(rename = "pull")]
    TrunkForce: Polar, "pull", "N", Critic;
    /// Push at the start of the coming policy step, a change of the trunk's velocity.
    Push: Polar, "push", "m/s", Critic;
    /// Mass that the trunk has beyond the robot's description.
    TrunkMass: Scalar, "additional trunk mass", "kg", Critic;
    /// Displacement of the trunk's centre of mass from the robot's description.
    TrunkOffset: Polar, "offset of the trunk's centre of mass", "m", Critic;
    /// Delay of the joint target.
    Latency: Scalar, "latency", "s", Critic;
}

/// Largest felt force that a policy observes on each axis \[N\]: a push within one step would be several hundred.
pub const MOST_FELT_N: f64 = 100.0;

/// Values of the simulator that no robot measures: only a critic may observe them.
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

/// Description of a quantity.
pub(super) struct About {
    pub(super) kind: Kind,
    /// Name of its numbers.
    pub(super) name: &'static str,
    /// Unit of its numbers; three units if they differ.
    pub(super) unit: &'static str,
    seen_by: SeenBy,
    #[cfg_attr(not(test), expect(dead_code, reason = "the table of docs/quantities.md"))]
    what: &'static str,
}

/// The networks that can observe a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SeenBy {
    /// Policy and critic.
    Policy,
    /// The critic alone, since only the simulator has the quantity.
    Critic,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(yaml::to_text(self).trim_end())
    }
}

impl Quantity {
    /// Returns true if only the simulator has the quantity, so that policies cannot observe it.
    pub fn is_privileged(self) -> bool {
        self.about().seen_by == SeenBy::Critic
    }

    /// Returns true if the quantity follows from the force that a robot feels.
    pub fn is_felt(self) -> bool {
        matches!(self, Quantity::FeltForce | Quantity::CommandedYield)
    }

    /// Measures this quantity into `out`, a slice of its width. `axes` selects the elements and signs of a vector;
    /// `values` are the phases of a clock or the values of a constant; `order` is the policy's order of joints.
    pub(super) fn measure(
        self,
        axes: &[(usize, f64)],
        (frequency_hz, values): (f64, &[f64]),
        order: &[usize; JOINTS],
        now: &ObservationInput<'_>,
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
            Quantity::FeltForce | Quantity::CommandedYield => {
                let [forward, left] = state.felt_force.unwrap_or_default();
                let gain = if self == Quantity::FeltForce { 1.0 } else { now.command.compliance.unwrap_or_default() };
                vector([forward, left, 0.0].map(|force| gain * force.clamp(-MOST_FELT_N, MOST_FELT_N)));
            }
            Quantity::CommandedCompliance => out[0] = now.command.compliance.unwrap_or_default(),
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
                out.iter_mut().zip(values).for_each(|(out, phase)| *out = wave(TAU * (turns + phase).fract()));
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
            Quantity::TrunkForce => vector(known.pull.into()),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the table of docs/quantities.md.
    fn table() -> String {
        let row = |quantity: &Quantity| {
            let About { kind, unit, seen_by, what, .. } = quantity.about();
            let numbers = match kind {
                Kind::Scalar => "1",
                Kind::Polar | Kind::Axial | Kind::Command => "3",
                Kind::Joints | Kind::FootVectors => "12",
                Kind::Feet => "4",
                Kind::Clock => "as many as `phases`",
                Kind::Constant => "as many as `values`",
            };
            let frame = match kind {
                _ if quantity.is_felt() => "heading",
                Kind::Polar | Kind::Axial | Kind::Command | Kind::FootVectors => "base",
                _ => "",
            };
            let seen_by = if seen_by == SeenBy::Policy { "policy, critic" } else { "critic" };
            format!("| `{quantity}` | {numbers} | {unit} | {frame} | {seen_by} |{what} |\n")
        };
        let head = "| quantity | numbers | unit | frame | observed by | what it is |\n|---|---|---|---|---|---|\n";
        [head.to_owned()].into_iter().chain(Quantity::ALL.iter().map(row)).collect()
    }

    #[test]
    fn page_of_quantities_has_table_of_source() {
        let table = table();
        let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/quantities.md")).unwrap();
        assert!(page.contains(&table), "docs/quantities.md needs this table:\n{table}");
    }
}

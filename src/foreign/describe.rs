//! A policy of ours described as one from elsewhere: what goes beside its ONNX file.

use std::fmt::Write as _;

use crate::go1::{JOINT_COUNT, joint_name};
use crate::policy::Policy;
use crate::task::observation::{LAYOUT, Quantity};

/// What the first line of such a file says.
const OURS: &str = "is a policy of Supple:";

/// Whether a YAML file is one that [`describe`] made.
pub fn is_described_by_us(text: &str) -> bool {
    text.lines().next().is_some_and(|line| line.starts_with("# ") && line.contains(OURS))
}

/// The YAML file for the ONNX file `onnx` that the policy was exported to.
pub fn describe(policy: &Policy, onnx: &str) -> String {
    let simulation = &policy.provenance.config.simulation;
    let joints: Vec<String> = (0..JOINT_COUNT).map(joint_name).collect();
    let mut text = String::new();
    // Writing into a String cannot fail.
    let _ = write!(
        text,
        "# {onnx} {OURS} {} samples, config {}, seed {}. It scales what it sees itself.\n\
         onnx: {}\n\
         simulation:\n  physics_rate_hz: {}\n  policy_rate_hz: {}\n  kp_n_m_per_rad: {:?}\n  kd_n_m_s_per_rad: {:?}\n  \
         latency_s: {:?}\n\
         joints: [{}]\n\
         nominal_pose_rad: {:?}\n\
         observation:\n",
        policy.provenance.samples,
        policy.provenance.config_name,
        policy.provenance.seed,
        // A JSON string is a YAML string.
        serde_json::Value::from(onnx),
        simulation.physics_rate_hz,
        simulation.policy_rate_hz,
        simulation.kp_n_m_per_rad,
        simulation.kd_n_m_s_per_rad,
        simulation.latency_s,
        joints.join(", "),
        policy.nominal_pose,
    );
    let paper = ", elements: [left, up, forward]";
    for block in LAYOUT {
        let (name, elements) = match block.quantity {
            Quantity::BaseHeight => ("base_height", ""),
            Quantity::LocalGravity => ("gravity", paper),
            Quantity::JointAngles => ("joint_angles", ""),
            Quantity::LocalVelocity => ("base_velocity", paper),
            Quantity::LocalAngularVelocity => ("angular_velocity", paper),
            Quantity::JointRates => ("joint_rates", ""),
            // The last target is of one step ago by itself.
            Quantity::JointTargets => ("last_target", ""),
            Quantity::Command => ("command", ", elements: [left, forward, yaw]"),
        };
        let past = block.age == 1 && block.quantity != Quantity::JointTargets;
        let _ = writeln!(text, "  - {{quantity: {name}{elements}{}}}", if past { ", steps_ago: 1" } else { "" });
    }
    text.push_str("action:\n  meaning: joint_angle\n  scale_rad: 1.0\n");
    text
}

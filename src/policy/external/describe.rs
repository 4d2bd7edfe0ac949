//! A policy of ours described as an external one: what goes beside its ONNX file.

use std::fmt::Write as _;

use crate::policy::Policy;
use crate::robot::joint_names;

/// What the first line of such a file says.
const OURS: &str = "is a policy of Supple:";

/// Whether a YAML file is one that [`describe`] made.
pub fn is_described_by_us(text: &str) -> bool {
    text.lines().next().is_some_and(|line| line.starts_with("# ") && line.contains(OURS))
}

/// The YAML file for the ONNX file `onnx` that the policy was exported to.
pub fn describe(policy: &Policy, onnx: &str) -> String {
    let simulation = &policy.provenance.config.simulation;
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
        joint_names().join(", "),
        policy.nominal_pose(),
    );
    for observed in &policy.provenance.config.observation {
        // Flow style is JSON, which is YAML.
        let mut entry = serde_json::to_value(observed).unwrap_or_default();
        if let Some(keys) = entry.as_object_mut() {
            ["offset", "scale", "clip"].into_iter().for_each(|key| drop(keys.remove(key)));
        }
        let _ = writeln!(text, "  - {entry}");
    }
    text.push_str("action:\n  meaning: joint_angle\n  scale_rad: 1.0\n");
    text
}

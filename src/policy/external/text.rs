//! The text of a description: the YAML file of an external policy.

use std::fmt::{self, Display, Formatter};

use super::framework::Found;
use crate::config::{RobotModel, Simulation};
use crate::util::yaml;

/// A description of an external policy; its `Display` is the YAML text.
pub(super) struct PolicyDescription<'a> {
    /// The first lines, a comment.
    pub(super) title: String,
    /// Path of the ONNX file, relative to the YAML file.
    pub(super) onnx: &'a str,
    pub(super) robot: &'a RobotModel,
    /// The range of compliances that the network was trained to be commanded \[m/s/N\].
    pub(super) compliance: Option<[f64; 2]>,
    pub(super) found: Found,
}

impl PolicyDescription<'_> {
    /// Returns the comment of a key, to go at the end of its line.
    fn note(&self, key: &str) -> String {
        let note = self.found.notes.iter().find(|(place, _)| *place == key);
        note.map_or_else(String::new, |(_, note)| format!("   # {note}"))
    }
}

impl Display for PolicyDescription<'_> {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        for line in self.title.lines() {
            writeln!(out, "# {}", line.replace(char::is_control, " "))?;
        }
        // JSON is YAML.
        writeln!(out, "onnx: {}", json(self.onnx))?;
        writeln!(out, "robot: {}{}", json(&yaml::without_defaults(self.robot)), self.note("robot"))?;
        let Found { simulation, joints, nominal_pose, observation, history, meaning, scale_rad, .. } = &self.found;
        let Simulation { physics_rate_hz, policy_rate_hz, kp_n_m_per_rad, kd_n_m_s_per_rad, latency_s } = simulation;
        writeln!(out, "simulation:")?;
        writeln!(out, "  physics_rate_hz: {physics_rate_hz}{}", self.note("physics_rate_hz"))?;
        writeln!(out, "  policy_rate_hz: {policy_rate_hz}{}", self.note("policy_rate_hz"))?;
        writeln!(out, "  kp_n_m_per_rad: {}\n  kd_n_m_s_per_rad: {}", json(kp_n_m_per_rad), json(kd_n_m_s_per_rad))?;
        writeln!(out, "  latency_s: {latency_s:?}{}", self.note("latency_s"))?;
        writeln!(out, "joints: [{}]\nnominal_pose_rad: {:?}", joints.join(", "), nominal_pose)?;
        writeln!(out, "observation:{}", self.note("observation"))?;
        for observed in observation {
            writeln!(out, "  - {}", json(&yaml::without_defaults(observed)))?;
        }
        if *history != [0] {
            writeln!(out, "history: {history:?}")?;
        }
        if let Some(range) = self.compliance {
            writeln!(out, "compliance_m_s_per_n: {range:?}")?;
        }
        writeln!(out, "action:\n  meaning: {}{}", json(meaning).trim_matches('"'), self.note("meaning"))?;
        writeln!(out, "  scale_rad: {}", json(scale_rad))
    }
}

/// Formats names, numbers and lists, whose serialisation cannot fail, as JSON.
fn json(value: &(impl serde::Serialize + ?Sized)) -> String {
    serde_json::to_value(value).unwrap_or_default().to_string()
}

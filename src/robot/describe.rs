//! A readable description of a robot.

use super::{JOINTS, Joints, Robot, joint_name};

impl Robot {
    /// Describes the values read from the robot's file and the changes made to it.
    pub fn description(&self) -> String {
        let height = self.standing_height_m(&self.nominal_pose);
        let mut text = format!("{}: {:.3} kg, trunk {height:.3} m above the ground\n", self.name, self.mass_kg);
        for line in &self.report {
            text.push_str(&format!("  {line}\n"));
        }
        text.push('\n');
        text.push_str(&joint_table(&self.nominal_pose, Some(&self.joint_limits), Some(&self.torque_limits)));
        text
    }
}

/// Returns a line for each joint: leg and part, name, nominal angle \[rad\], range \[rad\] and largest torque [N·m].
pub fn joint_table(pose: &Joints, limits: Option<&[[f64; 2]; JOINTS]>, torques: Option<&Joints>) -> String {
    let mut text = "joints            nominal [rad]  range [rad]         largest torque [N m]\n".to_owned();
    for (joint, angle) in pose.iter().enumerate() {
        let range = limits.map(|limits| limits[joint]);
        let range = range.map_or_else(|| "-".into(), |[low, high]| format!("{low:+.3} to {high:+.3}"));
        let torque = torques.map_or_else(|| "-".into(), |torques| torques[joint].to_string());
        text.push_str(&format!("  {joint:2}  {:12}{angle:+.4}        {range:20}{torque}\n", joint_name(joint)));
    }
    text
}

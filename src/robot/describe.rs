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
        text.push_str(&joint_table(&self.nominal_pose, &self.joint_limits, &self.torque_limits));
        text
    }
}

/// Returns a line for each joint: leg and part, name, nominal angle \[rad\], range \[rad\] and largest torque [N·m].
pub fn joint_table(pose: &Joints, limits: &[[f64; 2]; JOINTS], torques: &Joints) -> String {
    let mut text = "joints            nominal [rad]  range [rad]         largest torque [N m]\n".to_owned();
    for (joint, angle) in pose.iter().enumerate() {
        let [low, high] = limits[joint];
        let limited = low.is_finite() || high.is_finite();
        let range = if limited { format!("{low:+.3} to {high:+.3}") } else { "none".to_owned() };
        let torque = torques[joint];
        text.push_str(&format!("  {joint:2}  {:12}{angle:+.4}        {range:20}{torque}\n", joint_name(joint)));
    }
    text
}

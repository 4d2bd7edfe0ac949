//! A readable table of a robot's joints.

use super::{JOINTS, Joints, joint_name};

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

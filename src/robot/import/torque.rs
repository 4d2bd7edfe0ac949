//! The largest torque of each joint.

use super::names::Description;
use crate::mujoco::{Model, Object};
use crate::robot::error::RobotError;
use crate::robot::{JOINTS, Joints, joint_name};
use crate::util::numbers::short;

/// Returns the largest torque of each joint [N·m]: the description's, or the tightest of what bounds it in the file, the sum of
/// its actuators and the limit of the joint itself.
pub(super) fn torque_limits(
    model: &Model,
    joints: &[usize; JOINTS],
    description: &Description,
    of_joints: &[(String, [f64; 2])],
    notes: &mut Vec<String>,
) -> Result<Joints, RobotError> {
    if let Some(limits) = description.torque_limits {
        return Ok(limits);
    }
    let mut limits = [0.0; JOINTS];
    for (index, limit) in limits.iter_mut().enumerate() {
        let name = model.name(Object::Joint, joints[index]);
        let actuators = (0..model.count(Object::Actuator)).map(|id| model.actuator(id));
        let ranges: Vec<Option<[f64; 2]>> = actuators
            .filter(|actuator| actuator.joint == Some(joints[index]))
            .map(|actuator| {
                actuator.torque_range().filter(|range| range != &[0.0; 2] && range.iter().all(|t| t.is_finite()))
            })
            .collect();
        // One actuator without a limit is enough for any torque.
        let sum = ranges.iter().copied().collect::<Option<Vec<_>>>().filter(|ranges| !ranges.is_empty());
        let sum = sum.map(|ranges| ranges.iter().fold([0.0, 0.0], |sum, range| [sum[0] + range[0], sum[1] + range[1]]));
        let own = of_joints.iter().rev().find(|(joint, _)| joint == name).map(|(_, range)| *range);
        let [low, high] = match (sum, own) {
            (Some(sum), Some(own)) => [sum[0].max(own[0]), sum[1].min(own[1])],
            (Some(range), None) | (None, Some(range)) => range,
            (None, None) => return Err(RobotError::NoTorque(name.to_owned())),
        };
        ensure!(low < 0.0 && high > 0.0, RobotError::one_sided(name, [low, high]));
        *limit = high.min(-low);
        if (high + low).abs() > 1e-9 * high {
            let (low, high, limit) = (short(low), short(high), short(*limit));
            notes.push(format!("torque of {}: {low} to {high} N m, taken as ±{limit}", joint_name(index)));
        }
        if ranges.len() > 1 && sum.is_some() {
            let (count, limit) = (ranges.len(), short(*limit));
            notes.push(format!("torque of {}: {limit} N m, of {count} actuators together", joint_name(index)));
        }
    }
    Ok(limits)
}

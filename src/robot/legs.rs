/*! The order of legs and joints.

Every robot's joints have the same order, whatever its file calls them: legs FR, FL, RR, RL, in each hip (abduction),
thigh, calf. That is Unitree's order.
*/

/// Names of the legs, right before left, front before rear.
pub const LEGS: [&str; 4] = ["FR", "FL", "RR", "RL"];

/// Names of a leg's joints, from the trunk downwards.
pub const PARTS: [&str; 3] = ["hip", "thigh", "calf"];

/// Number of actuated joints.
pub const JOINTS: usize = LEGS.len() * PARTS.len();

/// One number for each joint, leg by leg in the order of [`LEGS`].
pub type Joints = [f64; JOINTS];

/// Returns the joint target that an action means: nominal pose + scale · action \[rad\] (section III-A).
pub fn joint_target(nominal_rad: f64, scale_rad: f64, action: f64) -> f64 {
    nominal_rad + scale_rad * action
}

/// Repeats a leg's three values, from the trunk downwards, for every leg.
pub fn same_in_every_leg<T: Copy>(of_leg: [T; 3]) -> [T; JOINTS] {
    std::array::from_fn(|joint| of_leg[joint % PARTS.len()])
}

/// Returns the name of a joint, such as `FR_hip`.
pub fn joint_name(joint: usize) -> String {
    format!("{}_{}", LEGS[joint / PARTS.len()], PARTS[joint % PARTS.len()])
}

/// Returns the name of the site that stands for a foot which is no sphere, such as `FR_sole`.
pub(super) fn sole_name(leg: usize) -> String {
    format!("{}_sole", LEGS[leg])
}

/// Returns the names of all joints.
pub fn joint_names() -> [String; JOINTS] {
    std::array::from_fn(joint_name)
}

/// Returns the joint on the other side of the robot.
pub fn opposite(joint: usize) -> usize {
    let (leg, part) = (joint / PARTS.len(), joint % PARTS.len());
    (leg ^ 1) * PARTS.len() + part
}

/// Returns the three numbers of a leg.
pub fn of_leg(joints: &Joints, leg: usize) -> [f64; 3] {
    std::array::from_fn(|part| joints[leg * PARTS.len() + part])
}

//! The description of a policy in the files of other frameworks, in terms of Supple's own description.

use crate::config::{PerJoint, Simulation};
use crate::observation::{Numbers, Observed, Quantity, StepsAgo};
use crate::policy::inference::Meaning;
use crate::robot::{JOINTS, joint_names};
use crate::util::files::FileError;

/// Longest history of a term \[policy steps\].
pub(super) const MAX_HISTORY: u32 = 200;

/// The content of a description, except the network and the robot.
pub(super) struct Found {
    /// Names of the joints in the policy's order.
    pub(super) joints: Vec<String>,
    /// Nominal pose in that order \[rad\].
    pub(super) nominal_pose: [f64; JOINTS],
    pub(super) simulation: Simulation,
    pub(super) observation: Vec<Observed>,
    /// Ages of the whole observation \[policy steps\].
    pub(super) history: Vec<u32>,
    pub(super) meaning: Meaning,
    /// Scale of the outputs \[rad\].
    pub(super) scale_rad: Numbers,
    /// Comments: the key beside which a comment goes, and the comment.
    pub(super) notes: Vec<(&'static str, &'static str)>,
}

/// Smallest physics rate that is assumed where a file has none \[Hz\]: that of Isaac Lab and mjlab at 50 policy steps a second.
const PHYSICS_RATE_HZ: u32 = 200;

/// Returns a simulation at this policy rate, with the gains of keys and lists, in the order of `joints`; other rates and the latency
/// are in no file.
pub(super) fn simulation(policy_rate_hz: u32, [kp, kd]: [(&str, &[f64]); 2], joints: &[String]) -> Result<Simulation> {
    let physics_rate_hz = policy_rate_hz * PHYSICS_RATE_HZ.div_ceil(policy_rate_hz);
    let (kp_n_m_per_rad, kd_n_m_s_per_rad) = (gain(kp.0, kp.1, joints)?, gain(kd.0, kd.1, joints)?);
    Ok(Simulation { physics_rate_hz, policy_rate_hz, kp_n_m_per_rad, kd_n_m_s_per_rad, latency_s: 0.0 })
}

/// A part of a file that has no counterpart in a description of ours, or that is wrong.
#[derive(Debug, thiserror::Error)]
pub(super) enum TranslationFault {
    #[error("{key} {found}, expected {expected}")]
    Value { key: String, found: String, expected: String },
    #[error("it has no {key}{remedy}")]
    Missing { key: String, remedy: &'static str },
    #[error("the observation has '{term}', which needs {needs}")]
    Term { term: String, needs: String },
    #[error("{0}")]
    Text(String),
    #[error(transparent)]
    File(#[from] FileError),
}

/// Returns the fault of a key that has another value than expected.
pub(super) fn value(key: &str, found: String, expected: impl Into<String>) -> TranslationFault {
    TranslationFault::Value { key: key.to_owned(), found, expected: expected.into() }
}

pub(super) type Result<T> = std::result::Result<T, TranslationFault>;

/// Returns the quantity of a term of Isaac Lab's observations; `joint_pos` is what that name stands for in the file.
pub(super) fn quantity(term: &str, joint_pos: Quantity) -> Result<Quantity> {
    let needs = match term {
        "base_lin_vel" => return Ok(Quantity::BaseVelocity),
        "base_ang_vel" => return Ok(Quantity::AngularVelocity),
        "projected_gravity" => return Ok(Quantity::ProjectedGravity),
        "velocity_commands" | "command" => return Ok(Quantity::Command),
        "joint_pos_rel" => return Ok(Quantity::JointOffsets),
        "joint_pos" => return Ok(joint_pos),
        "joint_vel_rel" | "joint_vel" => return Ok(Quantity::JointRates),
        "last_action" | "actions" => return Ok(Quantity::LastAction),
        "height_scan" | "height_scanner" => {
            "heights of the ground around the robot, which cannot be observed here: train without it"
        }
        "gait_phase" | "phase" => {
            "the gait's period, which this file does not have: write two entries by hand, clock_sin and clock_cos, with its \
             frequency_hz"
        }
        motion if motion.starts_with("motion_") => "a reference motion, which cannot be observed here",
        _ => {
            "a quantity that is not known here; known are base_lin_vel, base_ang_vel, projected_gravity, velocity_commands, \
             command, joint_pos_rel, joint_pos, joint_vel_rel, joint_vel, last_action and actions: write the description by \
             hand, as examples/policies/rsl_rl.yaml does, or train without it"
        }
    };
    Err(TranslationFault::Term { term: term.to_owned(), needs: needs.to_owned() })
}

/// Returns the ages of a history of `length` steps, the oldest first, as Isaac Lab has it; a length of 0 is 1.
pub(super) fn ages(length: u32) -> Vec<u32> {
    (0..length.max(1)).rev().collect()
}

/// Returns `steps_ago` for these ages; the default is not written.
pub(super) fn steps_ago(ages: &[u32]) -> Option<StepsAgo> {
    (ages != [0]).then(|| StepsAgo::Several(ages.to_vec()))
}

/// Checks that a list has one finite number for each joint of a quadruped.
pub(super) fn for_each_joint(key: &str, found: &[f64]) -> Result<[f64; JOINTS]> {
    let wrong = |found| value(key, found, format!("{JOINTS} finite numbers, one for each joint of a quadruped"));
    let numbers = <[f64; JOINTS]>::try_from(found).map_err(|_| wrong(format!("has {} numbers", found.len())))?;
    if numbers.iter().all(|number| number.is_finite()) { Ok(numbers) } else { Err(wrong(format!("is {numbers:?}"))) }
}

/// Returns the gains of a list in the order of `joints`, names that a leg and a part begin, such as `FL_hip_joint`.
fn gain(key: &str, found: &[f64], joints: &[String]) -> Result<PerJoint> {
    let gains = for_each_joint(key, found)?;
    if gains == [gains[0]; JOINTS] {
        return Ok(PerJoint::Same(gains[0]));
    }
    let mut ordered = [0.0; JOINTS];
    for (place, name) in joint_names().iter().enumerate() {
        let at = joints.iter().position(|joint| joint.strip_suffix("_joint").unwrap_or(joint) == name);
        let at = at.ok_or_else(|| {
            let found =
                format!("differs by joint, and no joint is named {name} or {name}_joint: {}", joints.join(", "));
            value(key, found, "such names, or one number for all joints")
        })?;
        ordered[place] = gains[at];
    }
    Ok(PerJoint::from(ordered))
}

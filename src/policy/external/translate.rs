/*! Descriptions of policies from the files of their frameworks.

[`translate`] reads the `deploy.yaml` of unitree_rl_lab and unitree_rl_mjlab (`deploy`), or the metadata of an ONNX file as mjlab
and Isaac Lab projects write them (`metadata`). Both become a [`Found`], whose text has a comment `check this` wherever the file
says nothing and a default is taken.
*/

use std::path::Path;

use super::text::Description;
use super::{deploy, metadata};
use crate::config::{PerJoint, RobotModel, Simulation};
use crate::observation::{Numbers, Observed, Quantity, StepsAgo};
use crate::policy::inference::Meaning;
use crate::robot::{JOINTS, joint_names};
use crate::util::files::FileError;

/// Name of the file type in error messages.
const SOURCE: &str = "policy";

/// Robot that is assumed where none is named.
const ROBOT: &str = "go2";

/// Smallest physics rate that is assumed where a file has none \[Hz\]: that of Isaac Lab and mjlab at 50 policy steps a second.
const PHYSICS_RATE_HZ: u32 = 200;

/// Longest history of a term \[policy steps\].
pub(super) const MAX_HISTORY: u32 = 200;

/// A description of another framework, in the terms of ours.
pub(super) struct Found {
    /// Names of the joints in the policy's order.
    pub(super) joints: Vec<String>,
    /// Nominal pose in that order \[rad\].
    pub(super) nominal_pose: [f64; JOINTS],
    pub(super) kp_n_m_per_rad: PerJoint,
    pub(super) kd_n_m_s_per_rad: PerJoint,
    pub(super) policy_rate_hz: u32,
    pub(super) observation: Vec<Observed>,
    /// Ages of the whole observation \[policy steps\].
    pub(super) history: Vec<u32>,
    pub(super) meaning: Meaning,
    /// Scale of the outputs \[rad\].
    pub(super) scale_rad: Numbers,
    /// Comments: the key beside which a comment goes, and the comment.
    pub(super) notes: Vec<(&'static str, &'static str)>,
}

/// A part of a file that has no counterpart in a description of ours, or that is wrong.
#[derive(Debug, thiserror::Error)]
pub(super) enum Fault {
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

/// Returns the YAML description, for the ONNX file `onnx`, of the policy that a file of its framework describes: a `deploy.yaml`,
/// or an ONNX file with metadata. The robot is `robot` or, if none is given, the Go2 with a comment.
///
/// # Errors
/// The file cannot be read, or says something that a description cannot state; the error names the key, what was found and what
/// was expected.
pub fn translate(source: &Path, onnx: &str, robot: Option<&str>) -> Result<String, FileError> {
    let is_onnx = source.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("onnx"));
    let found = if is_onnx { metadata::read(source) } else { deploy::read(source) };
    let mut found = found.map_err(|fault| match fault {
        Fault::File(error) => error,
        fault => FileError::of(SOURCE, source)(fault),
    })?;
    if robot.is_none() {
        found.notes.push(("robot", "check this: the file names no robot"));
    }
    let policy_rate_hz = found.policy_rate_hz;
    found.notes.push(("physics_rate_hz", "check this: the file has none"));
    found.notes.push(("latency_s", "check this: the file has none; delay of the joint target"));
    let description = Description {
        title: format!(
            "{onnx} as {} describes it, by `policy describe`. Check what is marked.",
            source.file_name().unwrap_or_default().display()
        ),
        onnx,
        robot: &RobotModel {
            model: robot.unwrap_or(ROBOT).to_owned(),
            friction_loss_n_m: 0.0,
            damping_n_m_s_per_rad: 0.0,
        },
        simulation: &Simulation {
            physics_rate_hz: policy_rate_hz * PHYSICS_RATE_HZ.div_ceil(policy_rate_hz),
            policy_rate_hz,
            kp_n_m_per_rad: found.kp_n_m_per_rad,
            kd_n_m_s_per_rad: found.kd_n_m_s_per_rad,
            latency_s: 0.0,
        },
        joints: found.joints,
        nominal_pose: &found.nominal_pose,
        observation: found.observation,
        history: found.history,
        meaning: match found.meaning {
            Meaning::OffsetFromNominal => "offset_from_nominal",
            Meaning::JointAngle => "joint_angle",
        },
        scale_rad: found.scale_rad,
        notes: &found.notes,
    };
    Ok(description.to_string())
}

/// Returns the quantity of a term of Isaac Lab's observations; `joint_pos` is what that name stands for in the file.
pub(super) fn quantity(term: &str, joint_pos: Quantity) -> Result<Quantity, Fault> {
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
            "heights of the ground around the robot, which no policy here sees: train without it"
        }
        "gait_phase" | "phase" => {
            "the gait's period, which this file does not have: write two entries by hand, clock_sin and clock_cos, with its \
             frequency_hz"
        }
        motion if motion.starts_with("motion_") => "a reference motion, which no policy here sees",
        _ => {
            "a quantity that is not known here; known are base_lin_vel, base_ang_vel, projected_gravity, velocity_commands, \
             command, joint_pos_rel, joint_pos, joint_vel_rel, joint_vel, last_action and actions: write the description by \
             hand, as examples/policies/rsl_rl.yaml does, or train without it"
        }
    };
    Err(Fault::Term { term: term.to_owned(), needs: needs.to_owned() })
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
pub(super) fn for_each_joint(key: &str, found: &[f64]) -> Result<[f64; JOINTS], Fault> {
    let wrong = |found| {
        let expected = format!("{JOINTS} finite numbers, one for each joint of a quadruped");
        Fault::Value { key: key.to_owned(), found, expected }
    };
    let numbers = <[f64; JOINTS]>::try_from(found).map_err(|_| wrong(format!("has {} numbers", found.len())))?;
    if numbers.iter().all(|number| number.is_finite()) { Ok(numbers) } else { Err(wrong(format!("is {numbers:?}"))) }
}

/// Returns the gains of a list in the order of `joints`, names that a leg and a part begin, such as `FL_hip_joint`.
pub(super) fn gain(key: &str, found: &[f64], joints: &[String]) -> Result<PerJoint, Fault> {
    let gains = for_each_joint(key, found)?;
    if gains == [gains[0]; JOINTS] {
        return Ok(PerJoint::Same(gains[0]));
    }
    let mut ordered = [0.0; JOINTS];
    for (place, name) in joint_names().iter().enumerate() {
        let at = joints.iter().position(|joint| joint.strip_suffix("_joint").unwrap_or(joint) == name);
        let at = at.ok_or_else(|| Fault::Value {
            key: key.to_owned(),
            found: format!("differs by joint, and no joint is named {name} or {name}_joint: {}", joints.join(", ")),
            expected: "such names, or one number for all joints".to_owned(),
        })?;
        ordered[place] = gains[at];
    }
    Ok(PerJoint::from(ordered))
}

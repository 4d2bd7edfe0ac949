//! The `deploy.yaml` of unitree_rl_lab and unitree_rl_mjlab, which deploys a policy on a Unitree robot.
//!
//! Gains are in the order of the SDK's motors, all else in the policy's order; `joint_ids_map` has the motor of each of the
//! policy's joints. Observations are in the order of the file: value, clip, scale (with `scale_first`: value, scale, clip), and of
//! each term its history, the oldest first (with `use_gym_history`: of the whole observation).

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::Path;

use serde::Deserialize;

use super::framework::{
    Found, MAX_HISTORY, Result, TranslationFault, ages, for_each_joint, quantity, simulation, steps_ago, value,
};
use crate::observation::{Numbers, Observed, Quantity};
use crate::policy::inference::Meaning;
use crate::robot::{JOINTS, joint_names};
use crate::util::yaml::{self, Text, Value};

/// The only action that a description can state.
const ACTION: &str = "JointPositionAction";

/// Largest relative error of `step_dt`, which the exporter rounds to three digits.
const ROUNDING: f64 = 5e-3;

/// The content of a file, except commands and joint names, which are not needed.
#[derive(Deserialize)]
struct Deploy {
    joint_ids_map: Vec<usize>,
    step_dt: f64,
    stiffness: Vec<f64>,
    damping: Vec<f64>,
    default_joint_pos: Vec<f64>,
    actions: BTreeMap<String, DeployAction>,
    /// Terms in order, and the switches `scale_first` and `use_gym_history` among them.
    observations: Value,
}

#[derive(Deserialize)]
struct DeployAction {
    scale: Vec<f64>,
    offset: Vec<f64>,
    /// Limits of each joint target \[rad\].
    clip: Option<Vec<[f64; 2]>>,
    #[serde(default)]
    joint_ids: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTerm {
    #[serde(default)]
    params: Value,
    scale: Option<Vec<f64>>,
    clip: Option<[f64; 2]>,
    history_length: Option<u32>,
}

/// Reads the description in a `deploy.yaml`.
pub(super) fn read(path: &Path) -> Result<Found> {
    let text = Text::read(path).map_err(|error| TranslationFault::Text(error.to_string()))?;
    let Deploy { joint_ids_map, step_dt, stiffness, damping, default_joint_pos, mut actions, observations } =
        yaml::layered(&[text]).map_err(|error| TranslationFault::Text(error.without_name()))?;
    let motors = joint_names();
    let joints = policy_order(&joint_ids_map)?.map(|motor| motors[motor].clone());
    let nominal_pose = for_each_joint("default_joint_pos", &default_joint_pos)?;
    let action = actions.remove(ACTION);
    let (Some(action), true) = (action, actions.is_empty()) else {
        let others: Vec<String> = actions.into_keys().collect();
        return Err(value("actions", format!("has {}", others.join(", ")), format!("{ACTION} and nothing else")));
    };
    let scale = for_each_joint("actions.JointPositionAction.scale", &action.scale)?;
    let mut notes = Vec::new();
    if check_action(&action, &joints)? {
        notes.push(("meaning", "the file's clip of joint targets, beyond a turn, is left out"));
    }
    let (observation, history) = observation(&observations)?;
    Ok(Found {
        meaning: meaning(&action.offset, &nominal_pose)?,
        nominal_pose,
        // The SDK's motors are Supple's joints, in the same order.
        simulation: simulation(policy_rate(step_dt)?, [("stiffness", &stiffness), ("damping", &damping)], &motors)?,
        joints: joints.into(),
        observation,
        history,
        scale_rad: Numbers::Each(scale.to_vec()),
        notes,
    })
}

/// Checks the map from the policy's joints to the SDK's motors: FR, FL, RR, RL, each hip, thigh, calf.
fn policy_order(map: &[usize]) -> Result<[usize; JOINTS]> {
    match <[usize; JOINTS]>::try_from(map) {
        Ok(order) if (0..JOINTS).all(|motor| order.contains(&motor)) => Ok(order),
        _ => Err(value(
            "joint_ids_map",
            format!("is {map:?}"),
            "each of 0 to 11 once, the motors of a quadruped in the SDK's order (FR, FL, RR, RL; hip, thigh, calf)",
        )),
    }
}

/// Returns the policy rate for a step \[s\], which the file rounds.
fn policy_rate(step_dt: f64) -> Result<u32> {
    let rate = step_dt.recip().round();
    if (1.0..=1000.0).contains(&rate) && (rate * step_dt - 1.0).abs() < ROUNDING {
        Ok(rate as u32)
    } else {
        Err(value("step_dt", format!("is {step_dt} s"), "the period of a whole number of steps a second, 1 to 1000"))
    }
}

/// Returns the meaning of the outputs: whether the offset that is added to them is the nominal pose or nothing.
fn meaning(offset: &[f64], nominal_pose: &[f64; JOINTS]) -> Result<Meaning> {
    let key = "actions.JointPositionAction.offset";
    let offset = for_each_joint(key, offset)?;
    if offset == *nominal_pose {
        Ok(Meaning::OffsetFromNominal)
    } else if offset == [0.0; JOINTS] {
        Ok(Meaning::JointAngle)
    } else {
        Err(value(key, format!("is {offset:?}"), "default_joint_pos or zeros: a description has no other offset"))
    }
}

/// Checks that an action is of all joints, and that its limits of joint targets, if any, are too wide to matter. Returns true if
/// it has some.
fn check_action(action: &DeployAction, joints: &[String; JOINTS]) -> Result<bool> {
    ensure!(is_of_all_joints(&action.joint_ids), of_some_joints("actions.JointPositionAction.joint_ids"));
    let limits = action.clip.as_deref().unwrap_or_default();
    // A target a turn away saturates any motor.
    match limits.iter().zip(joints).find(|([low, high], _)| !(*low <= -TAU && *high >= TAU)) {
        None => Ok(!limits.is_empty()),
        Some(([low, high], joint)) => Err(value(
            "actions.JointPositionAction.clip",
            format!("limits the joint target of {joint} to {low} to {high} rad"),
            "none, or a turn or more: a description limits outputs, not joint targets",
        )),
    }
}

/// Returns the entries of the observation and the ages of all of it together.
fn observation(terms: &Value) -> Result<(Vec<Observed>, Vec<u32>)> {
    let switch = |key: &str| terms.get(key).and_then(Value::as_bool).unwrap_or(false);
    let (scale_first, whole) = (switch("scale_first"), switch("use_gym_history"));
    let (mut entries, mut histories) = (Vec::new(), Vec::new());
    for (name, content) in terms.as_mapping().into_iter().flatten() {
        let Some(name) = name.as_str() else { continue };
        if matches!(name, "scale_first" | "use_gym_history") {
            continue;
        }
        let key = format!("observations.{name}");
        let term: RawTerm = yaml::typed(content.clone(), &[])
            .map_err(|error| TranslationFault::Text(format!("{key}: {}", error.without_name())))?;
        let length = term.history_length.unwrap_or(1);
        if length > MAX_HISTORY {
            let key = format!("{key}.history_length");
            return Err(value(&key, format!("is {length}"), format!("at most {MAX_HISTORY} steps")));
        }
        let history = ages(length);
        let own = if whole { vec![0] } else { history.clone() };
        entries.extend(observed(&key, name, &term, &own, scale_first)?);
        histories.push(history);
    }
    let Some(history) = histories.first().filter(|_| whole) else { return Ok((entries, vec![0])) };
    match histories.iter().find(|other| *other != history) {
        None => Ok((entries, history.clone())),
        Some(other) => Err(value(
            "observations.use_gym_history",
            format!("is true with a history_length of {} and of {}", history.len(), other.len()),
            "the same history_length in all observations",
        )),
    }
}

/// Returns the entries of a term at these ages.
fn observed(key: &str, name: &str, term: &RawTerm, ages: &[u32], scale_first: bool) -> Result<Vec<Observed>> {
    if !term.params.get("asset_cfg").and_then(|asset| asset.get("joint_ids")).is_none_or(is_of_all_joints) {
        return Err(of_some_joints(&format!("{key}.params.asset_cfg.joint_ids")));
    }
    let clip = clip(key, term, scale_first)?;
    if name == "gait_phase" {
        let period_s = term.params.get("period").and_then(Value::as_f64).filter(|period| *period > 0.0);
        let period_s = period_s
            .ok_or_else(|| TranslationFault::Missing { key: format!("{key}.params.period"), remedy: " [s]" })?;
        let [sine, cosine] = scales(key, term, 2)?[..] else { return Ok(Vec::new()) };
        let clocks = [(Quantity::ClockSin, sine), (Quantity::ClockCos, cosine)];
        let at = |age: &u32| {
            clocks.map(|(clock, scale)| Observed {
                frequency_hz: Some(period_s.recip()),
                scale: short(&[scale]),
                steps_ago: steps_ago(&[*age]),
                clip,
                ..Observed::now(clock)
            })
        };
        return Ok(ages.iter().flat_map(at).collect());
    }
    let quantity = quantity(name, Quantity::JointAngles)?;
    let is_vector = matches!(
        quantity,
        Quantity::BaseVelocity | Quantity::AngularVelocity | Quantity::ProjectedGravity | Quantity::Command
    );
    let scale = short(&scales(key, term, if is_vector { 3 } else { JOINTS })?);
    Ok(vec![Observed { scale, clip, steps_ago: steps_ago(ages), ..Observed::now(quantity) }])
}

/// Returns the scale of each of `width` numbers of a term.
fn scales(key: &str, term: &RawTerm, width: usize) -> Result<Vec<f64>> {
    let scales = term.scale.clone().unwrap_or_else(|| vec![1.0; width]);
    if scales.len() == width && scales.iter().all(|scale| scale.is_finite()) {
        Ok(scales)
    } else {
        Err(value(&format!("{key}.scale"), format!("has {} numbers", scales.len()), format!("{width} finite ones")))
    }
}

/// Returns scales as they are written: nothing if all are 1, one number if all are equal.
fn short(scales: &[f64]) -> Option<Numbers> {
    match scales.iter().all(|scale| *scale == scales[0]) {
        true if scales[0] == 1.0 => None,
        true => Some(Numbers::All(scales[0])),
        false => Some(Numbers::Each(scales.to_vec())),
    }
}

/// Returns the limit of a term's scaled numbers, as a description has it.
fn clip(key: &str, term: &RawTerm, scale_first: bool) -> Result<Option<f64>> {
    let Some([low, high]) = term.clip else { return Ok(None) };
    let scale = term.scale.as_deref().unwrap_or(&[1.0]);
    let key = format!("{key}.clip");
    ensure!(low == -high, value(&key, format!("is {low} to {high}"), "the same number with both signs"));
    match scale {
        _ if scale_first => Ok(Some(high)),
        [scale, others @ ..] if others.iter().all(|other| other == scale) => Ok(Some(high * scale.abs())),
        _ => Err(value(
            &key,
            format!("is {high} before a scale of {scale:?}"),
            "one scale for all elements, or no clip: a description limits scaled numbers",
        )),
    }
}

/// Returns true if these indices choose all joints in the policy's order: none, a whole slice as Python writes it, or 0 to 11.
fn is_of_all_joints(indices: &Value) -> bool {
    indices.as_sequence().map_or(indices.is_null(), |indices| {
        indices.iter().all(Value::is_null) || indices.iter().map(Value::as_u64).eq((0..JOINTS as u64).map(Some))
    })
}

fn of_some_joints(key: &str) -> TranslationFault {
    value(key, "chooses joints".to_owned(), "all 12 in the policy's order: a description observes and moves all")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PerJoint;
    use crate::policy::external::spec::Spec;
    use crate::policy::external::translate;

    /// A Go2 in Isaac Lab's order (hips, thighs, calves; FL, FR, RL, RR), with the tags that Python writes.
    const FILE: &str = "\
joint_ids_map: [3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8]
step_dt: 0.02
stiffness: [25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0]
damping: [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
default_joint_pos: [0.1, -0.1, 0.1, -0.1, 0.8, 0.8, 1.0, 1.0, -1.5, -1.5, -1.5, -1.5]
commands: {base_velocity: {ranges: {lin_vel_x: [-1.0, 1.0], heading: null}}}
actions:
  JointPositionAction:
    clip: null
    joint_names: [.*]
    scale: [0.125, 0.125, 0.125, 0.125, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25]
    offset: [0.1, -0.1, 0.1, -0.1, 0.8, 0.8, 1.0, 1.0, -1.5, -1.5, -1.5, -1.5]
    joint_ids: !!python/object/apply:builtins.slice [null, null, null]
observations:
  base_ang_vel: {params: {}, clip: [-100, 100], scale: [0.2, 0.2, 0.2], history_length: 2}
  velocity_commands: {params: {command_name: base_velocity}, clip: null, scale: [2.0, 2.0, 0.5], history_length: 1}
  joint_pos_rel: {params: {}, clip: null, scale: null, history_length: 2}
  last_action: {params: {}, clip: null, scale: null, history_length: 1}
";

    fn described(file: &str) -> std::result::Result<Spec, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deploy.yaml");
        std::fs::write(&path, file).unwrap();
        let text = translate(&path, "policy.onnx", None).map_err(|error| error.to_string())?;
        Spec::parse(Path::new("mine.yaml"), &text).map_err(|error| format!("{error}\n{text}"))
    }

    #[test]
    fn joints_go_through_the_map_to_the_motors() {
        let spec = described(FILE).unwrap();
        // FR, FL, RR, RL: left hips at 0.1, right ones at -0.1, front thighs at 0.8, rear ones at 1.0.
        let pose = [-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5];
        assert_eq!(spec.action.nominal_pose, pose);
        assert_eq!(spec.action.meaning, Meaning::OffsetFromNominal);
        // In the policy's order, as in the file.
        assert_eq!(spec.action.scale_rad[3..5], [0.125, 0.25]);
        let names = spec.layout.names();
        let last = names.len() - 12;
        assert_eq!(names[last], "previous FL_hip output [1]");
        assert_eq!(names[last + 6], "previous RL_thigh output [1]");
        let trained = &spec.config.simulation;
        assert_eq!((trained.physics_rate_hz, trained.policy_rate_hz), (200, 50));
        assert_eq!((trained.kp_n_m_per_rad, trained.kd_n_m_s_per_rad), (PerJoint::Same(25.0), PerJoint::Same(0.5)));
        assert_eq!(spec.config.robot.model, "go2");
    }

    #[test]
    fn gains_of_each_joint_are_kept() {
        // In the SDK's order: hip, thigh and calf of every leg; then those of one hip differ.
        let leg = |numbers: &str| format!("[{}]", [numbers; 4].join(", "));
        let text = FILE.replace(&leg("25.0, 25.0, 25.0"), &leg("20.0, 20.0, 40.0"));
        let text = text.replace("damping: [0.5,", "damping: [1.5,");
        let simulation = described(&text).unwrap().config.simulation;
        assert_eq!(simulation.kp_n_m_per_rad, PerJoint::Alike([20.0, 20.0, 40.0]));
        assert_eq!(simulation.kd_n_m_s_per_rad.joints()[..2], [1.5, 0.5]);
    }

    #[test]
    fn each_term_has_its_own_history_oldest_first() {
        let layout = described(FILE).unwrap().layout;
        let names = layout.names();
        // 2·3 angular velocities, 3 of the command, 2·12 angles, 12 outputs.
        assert_eq!(names.len(), 45);
        assert_eq!(names[0], "previous angular velocity forward [rad/s]");
        assert_eq!(names[3], "angular velocity forward [rad/s]");
        assert_eq!(names[9], "previous FL_hip angle from nominal [rad]");
        assert_eq!(names[21], "FL_hip angle from nominal [rad]");
        // A clip of 100 rad/s before the scale of 0.2 is one of 20 after it.
        assert_eq!((layout.scale()[0], layout.clip()[0]), (0.2, 20.0));
        assert_eq!(layout.scale()[6..9], [2.0, 2.0, 0.5]);
        let clipped = described(&FILE.replace("observations:", "observations:\n  scale_first: true")).unwrap().layout;
        assert_eq!(clipped.clip()[0], 100.0);
    }

    #[test]
    fn a_gym_history_is_of_the_whole_observation() {
        let file = FILE.replace("observations:", "observations:\n  use_gym_history: true");
        let error = described(&file).unwrap_err();
        assert!(error.contains("history_length of 2 and of 1"), "{error}");
        let layout = described(&file.replace("history_length: 1", "history_length: 2")).unwrap().layout;
        // 3 + 3 + 12 + 12 numbers, of the previous step first.
        assert_eq!((layout.length(), layout.history()), (60, &[1, 0][..]));
        assert_eq!(layout.names()[3], "previous commanded forward [m/s]");
        assert_eq!(layout.names()[33], "commanded forward [m/s]");
    }

    #[test]
    fn a_gait_phase_is_a_sine_and_a_cosine_at_each_age() {
        let term =
            "observations:\n  gait_phase: {params: {period: 0.8}, clip: null, scale: [1.0, 3.0], history_length: 2}";
        let layout = described(&FILE.replace("observations:", term)).unwrap().layout;
        assert_eq!(layout.scale()[..4], [1.0, 3.0, 1.0, 3.0]);
        let names = layout.names();
        assert_eq!(names[..2], ["previous sine of a clock 0 [1]", "previous cosine of a clock 0 [1]"]);
        assert_eq!(names[2], "sine of a clock 0 [1]");
        assert_eq!(layout.blocks()[0].frequency_hz, 1.25);
    }

    #[test]
    fn what_has_no_counterpart_is_refused_by_name() {
        for (from, to, expected) in [
            ("damping: [0.5, 0.5,", "damping: [0.5,", "damping has 11 numbers, expected 12"),
            ("joint_ids_map: [3, 0,", "joint_ids_map: [3, 3,", "expected each of 0 to 11 once"),
            ("step_dt: 0.02", "step_dt: 0.0", "step_dt is 0 s"),
            ("step_dt: 0.02", "step: 0.02", "step_dt"),
            ("offset: [0.1,", "offset: [0.2,", "offset is [0.2,"),
            ("Position", "Velocity", "actions has JointVelocityAction, expected JointPositionAction"),
            ("[null, null, null]", "[0, 6, null]", "joint_ids chooses joints"),
            ("    clip: null", "    clip: [[-100, 100], [-1, 1]]", "limits the joint target of FR_hip to -1 to 1 rad"),
            (
                "joint_pos_rel: {params: {}",
                "joint_pos_rel: {params: {asset_cfg: {joint_ids: [1]}}",
                "joint_pos_rel.params.asset_cfg.joint_ids chooses",
            ),
            ("base_ang_vel", "height_scan", "'height_scan', which needs heights of the ground"),
            ("base_ang_vel", "gait_phase", "has no observations.gait_phase.params.period"),
            ("base_ang_vel", "foot_forces", "'foot_forces', which needs a quantity that is not known here"),
            ("clip: [-100, 100]", "clip: [-100, 50]", "base_ang_vel.clip is -100 to 50"),
            ("0.2], history", "0.3], history", "base_ang_vel.clip is 100 before a scale of"),
            ("scale: [2.0, 2.0, 0.5]", "scale: [2.0]", "velocity_commands.scale has 1 numbers, expected 3 finite"),
            ("scale: [2.0, 2.0, 0.5]", "modifiers: 1", "observations.velocity_commands: modifiers: unknown field"),
        ] {
            assert!(FILE.contains(from), "{from}");
            let error = described(&FILE.replace(from, to)).unwrap_err();
            assert!(error.contains(expected) && error.contains("deploy.yaml"), "{expected}\n{error}");
        }
    }

    #[test]
    fn wide_clips_are_left_out_and_zero_offsets_are_joint_angles() {
        let spec = described(&FILE.replace("    clip: null", "    clip: [[-100, 100]]")).unwrap();
        assert_eq!(spec.action.clip, f64::INFINITY);
        let (before, rest) = FILE.split_once("    offset: [").unwrap();
        let (_, after) = rest.split_once(']').unwrap();
        let zeros = format!("{before}    offset: [0{}]{after}", ", 0".repeat(11));
        assert_eq!(described(&zeros).unwrap().action.meaning, Meaning::JointAngle);
    }

    #[test]
    fn a_joint_pos_is_the_angle_itself() {
        let layout = described(&FILE.replace("joint_pos_rel", "joint_pos")).unwrap().layout;
        assert_eq!(layout.names()[21], "FL_hip angle [rad]");
    }
}

//! The metadata of an ONNX file, as mjlab's exporter and those of Isaac Lab projects write them: keys, and values separated by
//! commas, in the order of `joint_names`. They have neither rates, scales nor clips.

use std::collections::BTreeMap;
use std::path::Path;

use super::framework::{
    Found, MAX_HISTORY, Result, TranslationFault, ages, for_each_joint, quantity, simulation, steps_ago, value,
};
use crate::observation::{Numbers, Observed, Quantity};
use crate::policy::inference::Meaning;
use crate::policy::onnx;
use crate::robot::JOINTS;

/// Policy rate of the velocity tasks of Isaac Lab and mjlab \[Hz\].
const POLICY_RATE_HZ: u32 = 50;

/// Names that a commanded velocity has in these frameworks; others are motions, poses, grasps.
const VELOCITY_COMMANDS: [&str; 2] = ["base_velocity", "twist"];

/// The remedy for a file without metadata, as the end of an error.
const REMEDY: &str = " among its metadata: export it with them, give the policy's deploy.yaml, or write the description by hand, as \
                      examples/policies/rsl_rl.yaml does (mujoco_playground: examples/policies/playground.yaml)";

/// Reads the description in an ONNX file.
pub(super) fn read(path: &Path) -> Result<Found> {
    found(&Entries(onnx::metadata(path)?))
}

fn found(entries: &Entries) -> Result<Found> {
    let joints: Vec<String> = entries.list("joint_names")?.iter().map(|name| short(name).to_owned()).collect();
    if joints.len() != JOINTS {
        let found = format!("has {} names", joints.len());
        return Err(value("joint_names", found, format!("the {JOINTS} joints of a quadruped")));
    }
    let scale = entries.numbers("action_scale")?;
    let scale_rad = match scale[..] {
        [scale] if scale.is_finite() => Numbers::All(scale),
        _ => Numbers::Each(for_each_joint("action_scale", &scale)?.to_vec()),
    };
    let (kp, kd) = (entries.numbers("joint_stiffness")?, entries.numbers("joint_damping")?);
    Ok(Found {
        nominal_pose: for_each_joint("default_joint_pos", &entries.numbers("default_joint_pos")?)?,
        simulation: simulation(POLICY_RATE_HZ, [("joint_stiffness", &kp), ("joint_damping", &kd)], &joints)?,
        joints,
        observation: observation(entries)?,
        history: vec![0],
        meaning: Meaning::OffsetFromNominal,
        scale_rad,
        notes: vec![
            ("policy_rate_hz", "check this: the file has none; usual in Isaac Lab and mjlab"),
            (
                "observation",
                "check this: the file has no scales and clips; joint_pos is taken as the offset from the nominal pose",
            ),
            ("meaning", "check this: the file does not say it; usual in Isaac Lab and mjlab"),
        ],
    })
}

/// Returns the entries of the observation: the terms in order, each with its own history.
fn observation(entries: &Entries) -> Result<Vec<Observed>> {
    let terms = entries.list("observation_names")?;
    let lengths = if entries.0.contains_key("observation_history_lengths") {
        entries.numbers("observation_history_lengths")?
    } else {
        vec![1.0; terms.len()]
    };
    if lengths.len() != terms.len() || !lengths.iter().all(|length| (0.0..=f64::from(MAX_HISTORY)).contains(length)) {
        let expected = format!("one number of steps, at most {MAX_HISTORY}, for each of {} observations", terms.len());
        return Err(value("observation_history_lengths", format!("is {lengths:?}"), expected));
    }
    let entry = |(term, length): (&String, f64)| {
        let quantity = quantity(term, Quantity::JointOffsets)?;
        if quantity == Quantity::Command {
            check_command(entries)?;
        }
        Ok(Observed { steps_ago: steps_ago(&ages(length as u32)), ..Observed::now(quantity) })
    };
    terms.iter().zip(lengths).map(entry).collect()
}

/// Checks that the policy's only command, if it is named, is a velocity.
fn check_command(entries: &Entries) -> Result<()> {
    let Some(found) = entries.0.get("command_names") else { return Ok(()) };
    if VELOCITY_COMMANDS.contains(&found.trim()) {
        return Ok(());
    }
    let expected = format!("one of {}: the command is a velocity here", VELOCITY_COMMANDS.join(", "));
    Err(value("command_names", format!("is '{found}'"), expected))
}

/// Returns the name of a joint without the name of its robot before a slash.
fn short(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// The metadata: keys and values.
struct Entries(BTreeMap<String, String>);

impl Entries {
    /// Splits a value at its commas.
    fn list(&self, key: &str) -> Result<Vec<String>> {
        let text = self.0.get(key).ok_or_else(|| TranslationFault::Missing { key: key.to_owned(), remedy: REMEDY })?;
        let text = text.trim().trim_matches(['[', ']', '(', ')']);
        Ok(text.split(',').map(|part| part.trim().trim_matches(['\'', '"']).to_owned()).collect())
    }

    fn numbers(&self, key: &str) -> Result<Vec<f64>> {
        let wrong = |part: &String| value(key, format!("has '{part}'"), "numbers separated by commas");
        let number = |part: &String| part.parse().map_err(|_| wrong(part));
        self.list(key)?.iter().map(number).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PerJoint;
    use crate::observation::StepsAgo;

    fn metadata(changes: &[(&str, &str)]) -> Entries {
        let entries = [
            (
                "joint_names",
                "robot/FL_hip_joint,FR_hip_joint,RL_hip_joint,RR_hip_joint,FL_thigh_joint,FR_thigh_joint,RL_thigh_joint,RR_thigh_joint,FL_calf_joint,FR_calf_joint,RL_calf_joint,RR_calf_joint",
            ),
            ("joint_stiffness", "25.000,25.000,25.000,25.000,25.000,25.000,25.000,25.000,25.000,25.000,25.000,25.000"),
            ("joint_damping", "0.500,0.500,0.500,0.500,0.500,0.500,0.500,0.500,0.500,0.500,0.500,0.500"),
            ("default_joint_pos", "0.100,-0.100,0.100,-0.100,0.800,0.800,1.000,1.000,-1.500,-1.500,-1.500,-1.500"),
            ("command_names", "twist"),
            ("observation_names", "base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,command"),
            ("action_scale", "0.25"),
        ];
        let owned = |(key, value): &(&str, &str)| (key.to_string(), value.to_string());
        Entries(entries.iter().chain(changes).map(owned).collect())
    }

    #[test]
    fn gains_of_each_joint_are_in_the_robots_order() {
        // Hips, thighs, calves in the file; FL before FR.
        let changes = [("joint_stiffness", "20,21,22,23,30,31,32,33,40,41,42,43")];
        let gains = found(&metadata(&changes)).ok().unwrap().simulation.kp_n_m_per_rad;
        assert_eq!(gains.joints(), [21.0, 31.0, 41.0, 20.0, 30.0, 40.0, 23.0, 33.0, 43.0, 22.0, 32.0, 42.0]);
    }

    #[test]
    fn joints_pose_and_terms_are_read_in_the_files_order() {
        let found = found(&metadata(&[("observation_history_lengths", "0,1,3,1,1,1,1")])).ok().unwrap();
        assert_eq!(found.joints[..2], ["FL_hip_joint", "FR_hip_joint"]);
        assert_eq!(found.nominal_pose[..2], [0.1, -0.1]);
        let gains = (found.simulation.kp_n_m_per_rad, found.simulation.kd_n_m_s_per_rad);
        assert_eq!(gains, (PerJoint::Same(25.0), PerJoint::Same(0.5)));
        assert_eq!(found.scale_rad, Numbers::All(0.25));
        let quantities: Vec<Quantity> = found.observation.iter().map(|observed| observed.quantity).collect();
        let [velocity, gravity] = [Quantity::BaseVelocity, Quantity::ProjectedGravity];
        assert_eq!(quantities[..4], [velocity, Quantity::AngularVelocity, gravity, Quantity::JointOffsets]);
        assert_eq!(quantities[4..], [Quantity::JointRates, Quantity::LastAction, Quantity::Command]);
        let ages: Vec<_> = found.observation.iter().map(|observed| observed.steps_ago.clone()).collect();
        assert_eq!(ages[..3], [None, None, Some(StepsAgo::Several(vec![2, 1, 0]))]);
    }

    #[test]
    fn what_has_no_counterpart_is_refused_by_name() {
        let twelve = |first: &str| format!("{first}{}", ",0.5".repeat(11));
        for (key, value, expected) in [
            ("joint_names", "FL_hip_joint,FR_hip_joint", "joint_names has 2 names, expected the 12 joints"),
            ("default_joint_pos", &twelve("nan"), "default_joint_pos is [NaN"),
            ("action_scale", "a quarter", "action_scale has 'a quarter', expected numbers"),
            ("action_scale", "0.25,0.5", "action_scale has 2 numbers, expected 12"),
            ("command_names", "motion", "command_names is 'motion', expected one of base_velocity, twist"),
            ("observation_names", "command,motion_b", "'motion_b', which needs a reference motion"),
            ("observation_names", "phase", "'phase', which needs the gait's period"),
            ("observation_history_lengths", "1,1", "observation_history_lengths is [1.0, 1.0], expected"),
        ] {
            let error = found(&metadata(&[(key, value)])).err().unwrap().to_string();
            assert!(error.contains(expected), "{expected}\n{error}");
        }
        let error = found(&Entries(BTreeMap::new())).err().unwrap().to_string();
        assert!(error.contains("no joint_names among its metadata") && error.contains("playground.yaml"), "{error}");
    }
}

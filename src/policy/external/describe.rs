/*! Descriptions of ONNX files: writes the YAML file that makes an exported network an external policy.

[`translate`] reads the `deploy.yaml` of unitree_rl_lab and unitree_rl_mjlab (`deploy`), or the metadata of an ONNX file as mjlab and Isaac
Lab projects write them (`metadata`). Its text has a comment `check this` wherever the file lacks a value and a default is used.
*/

use std::path::Path;

use super::framework::{Found, TranslationFault};
use super::text::PolicyDescription;
use super::{POLICY, deploy, metadata};
use crate::config::{Config, RobotModel};
use crate::observation::{NamedNumbers, Numbers, Observed, Quantity};
use crate::policy::inference::Meaning;
use crate::policy::{Policy, Provenance};
use crate::robot::{Joints, joint_names};
use crate::util::files::FileError;

/// The first line of a description that [`describe`] writes.
const OURS: &str = "is a policy of Supple:";

/// Robot that is assumed where none is named.
const ROBOT: &str = "go2";

/// Returns true if [`describe`] wrote this YAML text.
pub fn is_described_by_us(text: &str) -> bool {
    text.lines().next().is_some_and(|line| line.starts_with("# ") && line.contains(OURS))
}

/// Returns the YAML description of the ONNX file `onnx` that a policy was exported to.
pub fn describe(policy: &Policy, onnx: &str) -> String {
    let Provenance { config, config_name, seed, samples, .. } = &policy.provenance;
    let title = format!(
        "{onnx} {OURS} {samples} samples, config {config_name}, seed {seed}. It scales its observation itself."
    );
    let observation = config.observation.iter().map(|observed| {
        let observed = Observed { offset: None, scale: None, clip: None, ..observed.clone() };
        if observed.quantity != Quantity::LastAction {
            return observed;
        }
        // The exported network outputs joint targets: its last action follows from the last targets.
        let (offset, scale) = (policy.nominal_pose().to_vec(), config.action.scale_rad.recip());
        let (offset, scale) = (Some(Numbers::Each(offset)), Some(Numbers::All(scale)));
        Observed { quantity: Quantity::LastTarget, offset, scale, ..observed }
    });
    text(title, onnx, config, policy.nominal_pose(), observation, (Meaning::JointAngle, 1.0))
}

/// Returns the YAML description of the ONNX file `onnx` of a network trained in the environment of `config`: its inputs
/// are the normalised observations, its outputs the environment's actions.
pub fn describe_network(config_name: &str, config: &Config, onnx: &str) -> String {
    let title = format!("{onnx} acts in Supple's training environment, config {config_name}. Its inputs are scaled.");
    let pose = config.action.nominal_pose_rad.joints();
    // Such a file cannot state the nominal height, so it gets the number.
    let height = Numbers::All(config.reward.base_height_m);
    let observation = config.observation.iter().map(|observed| {
        let is_nominal_height =
            observed.quantity == Quantity::BaseHeight && observed.offset == Some(Numbers::Named(NamedNumbers::Nominal));
        let offset = if is_nominal_height { Some(height.clone()) } else { observed.offset.clone() };
        Observed { offset, ..observed.clone() }
    });
    text(title, onnx, config, &pose, observation, (Meaning::OffsetFromNominal, config.action.scale_rad))
}

/// Returns the YAML description, for the ONNX file `onnx`, of the policy that a file of its framework describes: a `deploy.yaml`,
/// or an ONNX file with metadata. The robot is `robot` or, if none is given, the Go2 with a comment.
///
/// # Errors
/// The file cannot be read, or has a setting that a description cannot state; the error names the key, what was found and what was
/// expected.
pub fn translate(source: &Path, onnx: &str, robot: Option<&str>) -> Result<String, FileError> {
    let is_onnx = source.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("onnx"));
    let found = if is_onnx { metadata::read(source) } else { deploy::read(source) };
    let mut found = found.map_err(|fault| match fault {
        TranslationFault::File(error) => error,
        fault => FileError::of(POLICY, source)(fault),
    })?;
    if robot.is_none() {
        found.notes.push(("robot", "check this: the file names no robot"));
    }
    found.notes.push(("physics_rate_hz", "check this: the file has none"));
    found.notes.push(("latency_s", "check this: the file has none; delay of the joint target"));
    let file = source.file_name().unwrap_or_default().display();
    let title = format!("{onnx} as {file} describes it, by `policy describe`. Check the marked lines.");
    let model = robot.unwrap_or(ROBOT).to_owned();
    let robot = &RobotModel { model, friction_loss_n_m: 0.0, damping_n_m_s_per_rad: 0.0 };
    Ok(PolicyDescription { title, onnx, robot, compliance: None, found }.to_string())
}

fn text(
    title: String,
    onnx: &str,
    Config { robot, simulation, reward, .. }: &Config,
    nominal_pose: &Joints,
    observation: impl Iterator<Item = Observed>,
    (meaning, scale_rad): (Meaning, f64),
) -> String {
    let (joints, nominal_pose, simulation) = (joint_names().into(), *nominal_pose, simulation.clone());
    let (observation, scale_rad, notes) = (observation.collect(), Numbers::All(scale_rad), Vec::new());
    let found = Found { joints, nominal_pose, simulation, observation, history: vec![0], meaning, scale_rad, notes };
    // A line end would let a part of the title out of the comment.
    let title = title.replace(char::is_control, " ");
    PolicyDescription { title, onnx, robot, compliance: reward.reference_m_s_per_n, found }.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::ActorCritic;
    use crate::observation::Command;
    use crate::policy::file::tests::untrained;
    use crate::policy::{Agent, Controller as _, onnx};
    use crate::robot::{JOINTS, RobotState};
    use crate::util::random::{Purpose, stream};

    #[test]
    fn exported_policies_act_and_remember_as_they_did() {
        let mut config = Config::load("compliant").unwrap();
        config.observation.truncate(3);
        config.observation.push(Observed { scale: Some(Numbers::All(0.5)), ..Observed::now(Quantity::LastAction) });
        for (name, config) in [("last action", config), ("blind", Config::load("real").unwrap())] {
            let inputs = config.layout().unwrap().length();
            let mut rng = stream(3, Purpose::Weights, 0, 0);
            let mut network = ActorCritic::orthogonal(inputs, &[16], JOINTS, -1.0, &mut rng);
            // Otherwise its outputs are nearly zero.
            network.policy.layers.iter_mut().flat_map(|layer| &mut layer.weight).for_each(|weight| *weight *= 3.0);
            let policy = untrained(&network, config);
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join("p.onnx"), onnx::export(&policy)).unwrap();
            std::fs::write(folder.path().join("p.yaml"), describe(&policy, "p.onnx")).unwrap();
            let exported = Agent::load(&folder.path().join("p.yaml")).unwrap();
            let own = Agent::from(Policy::from_bytes(&policy.to_bytes().unwrap(), Path::new("p")).unwrap());
            let (mut own, mut exported) = (own.inference().controller(), exported.inference().controller());
            let mut before = own.rest();
            for step in 0..8 {
                let state = RobotState {
                    height: 0.3,
                    gravity_in_base: nalgebra::Vector3::new(0.1 * f64::from(step), 0.0, -9.8),
                    joint_angles: [0.1 * f64::from(step * step); JOINTS],
                    ..RobotState::default()
                };
                let targets = [&mut own, &mut exported].map(|controller| {
                    if step == 0 {
                        controller.begin(&state);
                    }
                    controller.joint_targets(&state, &Command::default())
                });
                let [own, exported] = targets;
                assert_ne!(own, before, "{name}, step {step}");
                before = own;
                assert!(own.iter().zip(exported).all(|(a, b)| (a - b).abs() < 1e-5), "{name}: {own:?} {exported:?}");
            }
        }
    }
}

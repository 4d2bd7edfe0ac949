/*! The deployable policy: one safetensors file with everything that is needed to run it on a robot.

Weights and normaliser are tensors; what they mean (observation layout with units, joint order, nominal pose, scale,
gains, latency, rates, where it came from) is JSON under the metadata key `supple`. Three observations with the joint
targets they lead to are stored with it, so that every reader can check itself.
*/

use std::path::{Path, PathBuf};

use rand::RngExt;
use rand_distr::StandardNormal;
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};

use crate::config::{Config, GO1_NAME, Simulation};
use crate::files;
use crate::go1::{JOINT_COUNT, JOINT_LIMITS, Joints, TORQUE_LIMITS, joint_name, same_in_every_leg};
use crate::ppo::{ActorCritic, Layer, Mlp, PackedMlp, Scratch};
use crate::random::{Purpose, stream};
use crate::task::Normaliser;
use crate::task::observation::{LAYOUT, LENGTH, Observation, Quantity};
use crate::tensors::{self, Tensor};

/// Version of the file format.
pub const FORMAT: u32 = 1;

/// Larger files are not policies.
const MAX_BYTES: u64 = 64 << 20;

/// Stored pairs of observation and joint targets.
const GOLDEN: usize = 3;

/// Joint targets may differ by this much from the stored ones on another machine \[rad\].
const GOLDEN_TOLERANCE: f64 = 1e-5;

/// Why a policy file was refused.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// Reading or writing failed.
    #[error("policy {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The content is not a policy of this format.
    #[error("policy {}: {problem}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What was found and expected.
        problem: String,
    },
}

/// A stretch of the observation, in words for other programs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BlockInfo {
    /// What it is.
    pub quantity: Quantity,
    /// Policy steps ago that it was measured.
    pub age: u32,
    /// How many numbers.
    pub length: usize,
    /// Their unit.
    pub unit: String,
}

/// Where a policy came from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name of the configuration.
    pub config_name: String,
    /// The whole configuration.
    pub config: Config,
    /// Seed of the run.
    pub seed: u64,
    /// Samples it has seen.
    pub samples: u64,
    /// Git revision of the program that trained it.
    pub git_revision: String,
    /// MuJoCo version it was trained on.
    pub mujoco_version: String,
}

/// In words and numbers, what a program in another language needs to run the policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Usage {
    /// Name and unit of every number of the observation, in order.
    pub observation_elements: Vec<String>,
    /// What the first layer sees.
    pub network_input: String,
    /// What is between the layers.
    pub activation: String,
    /// What the last layer's outputs are.
    pub joint_target: String,
    /// Ranges of the joints; none of a robot from elsewhere \[rad\].
    pub joint_limits_rad: Option<[[f64; 2]; JOINT_COUNT]>,
    /// Limits of the PD law's torques; none of a robot from elsewhere [N·m].
    pub torque_limits_n_m: Option<Joints>,
}

impl Usage {
    /// For a robot of this name.
    fn new(model: &str) -> Self {
        let go1 = model == GO1_NAME;
        Usage {
            observation_elements: LAYOUT.iter().flat_map(|block| element_names(block.quantity, block.age)).collect(),
            network_input: "(observation - normaliser.offset) * normaliser.scale".into(),
            activation: "elu after every layer but the last; layer k is policy.k.weight, policy.k.bias".into(),
            joint_target: "nominal_pose_rad + scale_rad * output, held until the next step, for the PD law".into(),
            joint_limits_rad: go1.then(|| std::array::from_fn(|joint| JOINT_LIMITS[joint % 3])),
            torque_limits_n_m: go1.then(|| same_in_every_leg(TORQUE_LIMITS)),
        }
    }
}

/// Names and units of a block's numbers, such as `gravity left [m/s^2]`.
fn element_names(quantity: Quantity, age: u32) -> Vec<String> {
    let of_joints = |what: &str| (0..JOINT_COUNT).map(|joint| format!("{} {what}", joint_name(joint))).collect();
    let of_axes = |what: &str| ["left", "up", "forward"].iter().map(|axis| format!("{what} {axis}")).collect();
    let names: Vec<String> = match quantity {
        Quantity::BaseHeight => vec!["base height".into()],
        Quantity::LocalGravity => of_axes("gravity"),
        Quantity::JointAngles => of_joints("angle"),
        Quantity::LocalVelocity => of_axes("velocity"),
        Quantity::LocalAngularVelocity => of_axes("angular velocity"),
        Quantity::JointRates => of_joints("rate"),
        Quantity::JointTargets => of_joints("target"),
        Quantity::Command => ["left", "forward", "yaw rate"].iter().map(|what| format!("commanded {what}")).collect(),
    };
    let units: Vec<&str> = quantity.unit().split(", ").collect();
    let when = if age == 0 { "" } else { "previous " };
    let named = names.iter().enumerate();
    named.map(|(index, name)| format!("{when}{name} [{}]", units[index % units.len()])).collect()
}

/// The JSON under the metadata key `supple`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Metadata {
    format: u32,
    observation: Vec<BlockInfo>,
    joints: Vec<String>,
    nominal_pose_rad: Joints,
    scale_rad: f64,
    simulation: Simulation,
    provenance: Provenance,
    usage: Usage,
}

/// A trained policy with what is needed to use it.
#[derive(Debug)]
pub struct Policy {
    /// From normalised observation to action, mean only.
    pub actor: Mlp,
    /// Scaling of the observation.
    pub normaliser: Normaliser,
    /// Joint targets at action zero \[rad\].
    pub nominal_pose: Joints,
    /// \[rad\] per unit of action.
    pub scale_rad: f64,
    /// Where it came from; rates, gains and latency are those of its configuration.
    pub provenance: Provenance,
    /// For other programs.
    pub usage: Usage,
    packed: PackedMlp,
}

impl Policy {
    /// The deterministic policy of a network in training.
    pub fn new(network: &ActorCritic, provenance: Provenance) -> Self {
        let config = &provenance.config;
        Policy {
            packed: PackedMlp::new(&network.policy),
            actor: network.policy.clone(),
            normaliser: Normaliser::new(config),
            nominal_pose: same_in_every_leg(config.action.nominal_pose_rad),
            scale_rad: config.action.scale_rad,
            usage: Usage::new(&config.robot.model),
            provenance,
        }
    }

    /// Joint targets \[rad\] for an observation in physical units.
    pub fn joint_targets(&self, observation: &Observation, scratch: &mut Scratch) -> Joints {
        let (mut seen, mut action) = ([0.0; LENGTH], [0.0; JOINT_COUNT]);
        self.normaliser.apply(observation, &mut seen);
        self.packed.forward(1, &seen, &mut action, scratch);
        std::array::from_fn(|joint| self.nominal_pose[joint] + self.scale_rad * f64::from(action[joint]))
    }

    /// Bytes of the policy file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, safetensors::SafeTensorError> {
        let mut all = Vec::new();
        for (index, layer) in self.actor.layers.iter().enumerate() {
            let shape = vec![layer.outputs(), layer.inputs()];
            all.push(Tensor::f32(format!("policy.{index}.weight"), shape, &layer.weight));
            all.push(Tensor::f32(format!("policy.{index}.bias"), vec![layer.outputs()], &layer.bias));
        }
        let (observations, targets) = self.golden();
        all.push(Tensor::f64("normaliser.offset", vec![LENGTH], &self.normaliser.offset));
        all.push(Tensor::f64("normaliser.scale", vec![LENGTH], &self.normaliser.scale));
        all.push(Tensor::f64("golden.observation", vec![GOLDEN, LENGTH], &observations));
        all.push(Tensor::f64("golden.joint_target", vec![GOLDEN, JOINT_COUNT], &targets));
        tensors::serialize(&all, self.metadata_json())
    }

    /// The metadata as JSON.
    pub fn metadata_json(&self) -> String {
        let metadata = Metadata {
            format: FORMAT,
            observation: layout_info(),
            joints: (0..JOINT_COUNT).map(joint_name).collect(),
            nominal_pose_rad: self.nominal_pose,
            scale_rad: self.scale_rad,
            simulation: self.provenance.config.simulation.clone(),
            provenance: self.provenance.clone(),
            usage: self.usage.clone(),
        };
        // Plain structs of finite numbers and strings: serialising them cannot fail.
        serde_json::to_string(&metadata).unwrap_or_default()
    }

    /// Identity: the SHA-256 of the policy file.
    pub fn sha256(&self) -> String {
        // A policy that was built or read once can be serialised.
        files::sha256(&[&self.to_bytes().unwrap_or_default()])
    }

    /// Writes the policy file atomically.
    ///
    /// # Errors
    /// [`PolicyError`] with the file's name.
    pub fn save(&self, path: &Path) -> Result<(), PolicyError> {
        let bytes = self.to_bytes().map_err(|error| invalid(path, error))?;
        files::write_atomically(path, &bytes).map_err(|source| PolicyError::Io { path: path.to_owned(), source })
    }

    /// Reads a policy file and checks everything in it, the golden pairs included.
    ///
    /// # Errors
    /// [`PolicyError`] that says what was found and what was expected.
    pub fn load(path: &Path) -> Result<Self, PolicyError> {
        let bytes =
            files::read_bounded(path, MAX_BYTES).map_err(|source| PolicyError::Io { path: path.to_owned(), source })?;
        Self::from_bytes(&bytes, path)
    }

    /// As [`Policy::load`] from memory; `path` is for messages.
    ///
    /// # Errors
    /// See [`Policy::load`].
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, PolicyError> {
        let fail = |problem: String| PolicyError::Invalid { path: path.to_owned(), problem };
        let (tensors, json) = tensors::deserialize(bytes).map_err(fail)?;
        let metadata: Metadata =
            serde_json::from_str(&json).map_err(|error| fail(format!("its metadata do not parse: {error}")))?;
        metadata.check().map_err(fail)?;

        let read = |name: &str, shape: &[usize]| tensors::read_f64(&tensors, name, shape).map_err(fail);
        let normaliser =
            Normaliser { offset: read("normaliser.offset", &[LENGTH])?, scale: read("normaliser.scale", &[LENGTH])? };
        let actor = read_actor(&tensors).map_err(fail)?;
        let policy = Policy {
            packed: PackedMlp::new(&actor),
            actor,
            normaliser,
            nominal_pose: metadata.nominal_pose_rad,
            scale_rad: metadata.scale_rad,
            provenance: metadata.provenance,
            usage: metadata.usage,
        };
        let observations = read("golden.observation", &[GOLDEN, LENGTH])?;
        let expected = read("golden.joint_target", &[GOLDEN, JOINT_COUNT])?;
        let found = policy.targets_of(&observations);
        let worst = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if worst.is_nan() || worst > GOLDEN_TOLERANCE {
            return Err(fail(format!(
                "its golden joint targets are off by {worst:.2e} rad, at most {GOLDEN_TOLERANCE:.0e} is expected: \
                 the file is damaged"
            )));
        }
        Ok(policy)
    }

    fn targets_of(&self, observations: &[f64]) -> Vec<f64> {
        let mut scratch = Scratch::default();
        let rows = observations.chunks_exact(LENGTH);
        rows.flat_map(|row| {
            let mut observation = [0.0; LENGTH];
            observation.copy_from_slice(row);
            self.joint_targets(&observation, &mut scratch)
        })
        .collect()
    }

    /// Plausible observations and the joint targets they lead to.
    fn golden(&self) -> (Vec<f64>, Vec<f64>) {
        let mut rng = stream(0, Purpose::Weights, u64::MAX, 0);
        let observations: Vec<f64> = (0..GOLDEN * LENGTH)
            .map(|k| {
                let (offset, scale) = (self.normaliser.offset[k % LENGTH], self.normaliser.scale[k % LENGTH]);
                offset + 0.5 * rng.sample::<f64, _>(StandardNormal) / scale
            })
            .collect();
        let targets = self.targets_of(&observations);
        (observations, targets)
    }
}

impl Metadata {
    fn check(&self) -> Result<(), String> {
        if self.format != FORMAT {
            return Err(format!("its format is {}, this program reads {FORMAT}", self.format));
        }
        if self.observation != layout_info() {
            let lengths: usize = self.observation.iter().map(|block| block.length).sum();
            return Err(format!("its observation has another layout ({lengths} numbers) than the paper's {LENGTH}"));
        }
        let joints: Vec<String> = (0..JOINT_COUNT).map(joint_name).collect();
        if self.joints != joints {
            return Err(format!("its joints are {:?}, expected {joints:?}", self.joints));
        }
        let finite = self.nominal_pose_rad.iter().all(|angle| angle.is_finite()) && self.scale_rad.is_finite();
        if !finite {
            return Err("its nominal pose or scale is not finite".into());
        }
        let config = &self.provenance.config;
        if self.simulation != config.simulation {
            return Err("its simulation differs from that of the configuration it was trained with".into());
        }
        let named = self.usage.observation_elements.len();
        if named != LENGTH {
            return Err(format!("its description names {named} numbers of the observation, expected {LENGTH}"));
        }
        config.check().map_err(|error| error.to_string())
    }
}

/// The observation's layout in words and numbers.
pub fn layout_info() -> Vec<BlockInfo> {
    let info = |quantity: Quantity, age| BlockInfo {
        quantity,
        age,
        length: quantity.length(),
        unit: quantity.unit().to_owned(),
    };
    LAYOUT.iter().map(|block| info(block.quantity, block.age)).collect()
}

fn read_actor(tensors: &SafeTensors<'_>) -> Result<Mlp, String> {
    let (mut layers, mut inputs) = (Vec::new(), LENGTH);
    while let Ok(view) = tensors.tensor(&format!("policy.{}.weight", layers.len())) {
        let index = layers.len();
        let outputs = view.shape().first().copied().unwrap_or(0);
        let weight = tensors::read_f32(tensors, &format!("policy.{index}.weight"), &[outputs, inputs])?;
        let bias = tensors::read_f32(tensors, &format!("policy.{index}.bias"), &[outputs])?;
        if outputs == 0 {
            return Err(format!("its tensor policy.{index}.weight has no rows"));
        }
        layers.push(Layer { weight, bias });
        inputs = outputs;
    }
    if layers.is_empty() || inputs != JOINT_COUNT {
        let found = layers.len();
        return Err(format!("its network has {found} layers and {inputs} outputs, expected {JOINT_COUNT} outputs"));
    }
    Ok(Mlp { layers })
}

fn invalid(path: &Path, error: impl ToString) -> PolicyError {
    PolicyError::Invalid { path: path.to_owned(), problem: error.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn policy() -> Policy {
        let config = Config::load("compliant").unwrap();
        let mut rng = stream(5, Purpose::Weights, 0, 0);
        let network = ActorCritic::orthogonal(LENGTH, &[32, 16], JOINT_COUNT, -1.0, &mut rng);
        let provenance = Provenance {
            config_name: "compliant".into(),
            config,
            seed: 5,
            samples: 0,
            git_revision: "test".into(),
            mujoco_version: "2.2.2".into(),
        };
        Policy::new(&network, provenance)
    }

    #[test]
    fn a_policy_survives_its_file_bit_for_bit() {
        let policy = policy();
        let bytes = policy.to_bytes().unwrap();
        let read = Policy::from_bytes(&bytes, Path::new("test")).unwrap();
        assert_eq!(read.actor, policy.actor);
        assert_eq!(read.provenance, policy.provenance);
        assert_eq!(read.to_bytes().unwrap(), bytes);
    }

    #[test]
    fn the_shipped_policies_keep_their_bytes_and_so_their_identity() {
        for (name, bytes) in crate::policies::EMBEDDED {
            let policy = Policy::from_bytes(bytes, Path::new(name)).unwrap();
            assert_eq!(policy.sha256(), files::sha256(&[bytes]), "{name}");
        }
    }

    #[test]
    fn every_number_of_the_observation_has_a_name_and_a_unit() {
        let names = policy().usage.observation_elements;
        assert_eq!(names.len(), LENGTH);
        assert_eq!(names[0], "previous base height [m]");
        assert_eq!(names[34], "previous FR_hip target [rad]");
        assert_eq!(names[46], "base height [m]");
        assert_eq!(names[80..], ["commanded left [m/s]", "commanded forward [m/s]", "commanded yaw rate [rad/s]"]);
        assert_eq!(names.iter().collect::<std::collections::BTreeSet<_>>().len(), LENGTH);
    }

    #[test]
    fn every_truncation_is_refused_without_panic() {
        let bytes = policy().to_bytes().unwrap();
        for length in (0..bytes.len()).step_by(97) {
            assert!(Policy::from_bytes(&bytes[..length], Path::new("cut")).is_err());
        }
    }

    #[test]
    fn a_flipped_weight_is_caught_by_the_golden_pairs() {
        let bytes = policy().to_bytes().unwrap();
        let mut caught = 0;
        for position in (bytes.len() / 2..bytes.len()).step_by(1009) {
            let mut damaged = bytes.clone();
            damaged[position] ^= 0x40;
            caught += usize::from(Policy::from_bytes(&damaged, Path::new("damaged")).is_err());
        }
        assert!(caught > 0);
    }

    #[test]
    fn a_network_of_other_dimensions_is_named() {
        let mut other = policy();
        other.actor.layers.pop();
        let error = Policy::from_bytes(&other.to_bytes().unwrap(), Path::new("other")).unwrap_err().to_string();
        assert!(error.contains("16 outputs, expected 12"), "{error}");
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig {
            cases: 200, failure_persistence: None, ..proptest::prelude::ProptestConfig::default()
        })]

        #[test]
        fn headers_changed_at_random_never_panic(
            changes in proptest::collection::vec((0_usize..6000, proptest::prelude::any::<u8>()), 1..8),
        ) {
            static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
            let mut bytes = BYTES.get_or_init(|| policy().to_bytes().unwrap()).clone();
            for (place, byte) in changes {
                bytes[place] = byte;
            }
            // Refused or harmless: what is read has sane rates, and so a short queue of delayed targets.
            if let Ok(policy) = Policy::from_bytes(&bytes, Path::new("changed")) {
                policy.joint_targets(&[0.0; LENGTH], &mut Scratch::default());
                proptest::prop_assert!(policy.provenance.config.simulation.physics_rate_hz <= 20_000);
            }
        }
    }
}

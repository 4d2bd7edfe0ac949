/*! The policy file: one safetensors file with all that is needed to run a policy on a robot.

Weights and normaliser are tensors; their meaning (observation layout with units, joint order, nominal pose, scale,
gains, latency, rates, provenance) is JSON under the metadata key `supple`. The file also contains three observations
and their joint targets, with which every reader can test itself.
*/

use std::path::Path;

use rand::RngExt;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::inference::{Inference, InferenceBuffers, Network};
use super::pytorch;
use crate::config::{Config, Simulation, ValueError};
use crate::network::{ActorCritic, Layer, Mlp, NetworkError, PackedMlp};
use crate::observation::{Layout, LayoutError};
use crate::robot::{JOINTS, Joints, Robot, joint_names};
use crate::util::files::{self, FileError};
use crate::util::numbers;
use crate::util::random::{Purpose, stream};
use crate::util::tensors::{self, StoredTensor, TensorError};
use crate::util::yaml;

/// Version of the file format that is written.
pub const FORMAT: u32 = 1;

/// Maximum size of a policy file \[bytes\].
const MAX_BYTES: u64 = 64 << 20;

/// Name of the file type in error messages.
const POLICY: &str = "policy";

/// Number of stored pairs of observation and joint targets.
const GOLDEN: usize = 3;

/// Largest difference from the stored joint targets on another machine \[rad\].
const GOLDEN_TOLERANCE: f64 = 1e-5;

/// Description of a block of the observation, for other programs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct BlockInfo {
    quantity: String,
    /// Age of the measurement \[policy steps\].
    age: u32,
    length: usize,
    unit: String,
}

/// Origin of a policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name of the configuration.
    pub config_name: String,
    /// The whole configuration.
    #[serde(serialize_with = "yaml::serialize_without_defaults")]
    pub config: Config,
    /// Seed of the run.
    pub seed: u64,
    /// Number of training samples.
    pub samples: u64,
    /// Git revision of the program that trained the policy.
    pub git_revision: String,
    /// MuJoCo version that simulated the training.
    pub mujoco_version: String,
    /// Samples of the policies whose weights were averaged into this one; empty for a policy as it was trained.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mean_of: Vec<u64>,
}

impl Provenance {
    /// Describes what was averaged, if anything: `, mean of the weights at 100, 200`.
    pub fn mean(&self) -> String {
        let samples: Vec<String> = self.mean_of.iter().map(u64::to_string).collect();
        if samples.is_empty() { String::new() } else { format!(", mean of the weights at {}", samples.join(", ")) }
    }

    /// Describes how far the training had come, unless it was complete.
    pub fn unfinished(&self) -> Option<String> {
        let (found, planned) = (self.samples, self.config.run.samples);
        (found < planned).then(|| format!("is unfinished: {found} of {planned} samples so far"))
    }
}

/// Instructions for a program in another language that runs the policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Usage {
    /// Name and unit of every number of the observation, in order.
    pub observation_elements: Vec<String>,
    /// Formula of the first layer's input.
    pub network_input: String,
    /// Activation between the layers, and names of the weights.
    pub activation: String,
    /// Formula from the last layer's outputs to joint targets.
    pub joint_target: String,
    /// Ranges of the joints \[rad\], infinite for joints without limits; missing in old files of imported robots.
    #[serde(with = "limits")]
    pub joint_limits_rad: [[f64; 2]; JOINTS],
    /// Torque limits of the PD controller [N·m]; missing in old files of imported robots.
    pub torque_limits_n_m: Joints,
}

/// Ranges of joints in JSON, which has no infinite numbers: a joint without limits is `null`.
mod limits {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::robot::JOINTS;

    type Limits = [[f64; 2]; JOINTS];

    pub(super) fn serialize<S: Serializer>(limits: &Limits, serializer: S) -> Result<S::Ok, S::Error> {
        limits
            .map(|range| Some(range).filter(|range| range.iter().all(|limit| limit.is_finite())))
            .serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Limits, D::Error> {
        let limits = <[Option<[f64; 2]>; JOINTS]>::deserialize(deserializer)?;
        Ok(limits.map(|range| range.unwrap_or([f64::NEG_INFINITY, f64::INFINITY])))
    }
}

impl Usage {
    fn new(layout: &Layout, robot: &Robot) -> Self {
        let clipped = if layout.clips() { ", clipped as the configuration has it" } else { "" };
        Usage {
            observation_elements: layout.names(),
            network_input: format!("(observation - normaliser.offset) * normaliser.scale{clipped}"),
            activation: "elu after every layer but the last; layer k is policy.k.weight, policy.k.bias".into(),
            joint_target: "nominal_pose_rad + scale_rad * output, held until the next step, for the PD law".into(),
            joint_limits_rad: robot.joint_limits,
            torque_limits_n_m: robot.torque_limits,
        }
    }
}

/// The JSON under the metadata key `supple`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct PolicyMetadata {
    format: u32,
    observation: Vec<BlockInfo>,
    joints: Vec<String>,
    nominal_pose_rad: Joints,
    scale_rad: f64,
    #[serde(serialize_with = "yaml::serialize_without_defaults")]
    simulation: Simulation,
    provenance: Provenance,
    usage: Usage,
}

/// A trained policy: the network and everything that a robot needs to run it.
///
/// ```
/// use supple::policy::{InferenceBuffers, shipped};
/// use supple::train::{Curriculum, environment::LocomotionEnv};
///
/// let policy = shipped::find_ours("compliant")?; // a shipped name, a policy file or a run's folder
/// let mut env = LocomotionEnv::new(&policy.provenance.config, 0, 0, Curriculum::complete())?;
/// env.without_stagger();
/// let (nominal, mut buffers) = (policy.nominal_pose(), InferenceBuffers::default());
/// for _ in 0..60 {
///     let targets = policy.joint_targets(&env.observation(), &mut buffers); // twelve angles [rad]
///     let action: [f32; 12] = std::array::from_fn(|j| ((targets[j] - nominal[j]) / policy.scale_rad()) as f32);
///     assert_eq!(env.step(&action).0.end, None); // it walks for a second
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Policy {
    /// The network from normalised observation to the mean action.
    pub actor: Mlp,
    /// Origin of the policy; its configuration has the rates, gains and latency.
    pub provenance: Provenance,
    /// Instructions for other programs.
    pub usage: Usage,
    inference: Inference,
    /// SHA-256 of the file that the policy was read from, or would be written to.
    sha256: String,
}

impl Policy {
    /// Creates the deterministic policy of a network in training, for a `robot` observed with `layout`.
    pub fn new(network: &ActorCritic, robot: &Robot, layout: Layout, mut provenance: Provenance) -> Self {
        provenance.config = provenance.config.without_folder();
        let config = &provenance.config;
        let usage = Usage::new(&layout, robot);
        let (pose, scale_rad) = (config.action.nominal_pose_rad.joints(), config.action.scale_rad);
        Self::assemble(network.policy.clone(), layout, pose, scale_rad, provenance, usage)
    }

    /// Creates a policy that is in no file yet.
    fn assemble(
        actor: Mlp,
        layout: Layout,
        nominal_pose: Joints,
        scale_rad: f64,
        provenance: Provenance,
        usage: Usage,
    ) -> Self {
        let (mlp, period_s) = (Network::Mlp(PackedMlp::new(&actor)), provenance.config.simulation.policy_period_s());
        let inference = Inference::new(layout, nominal_pose, scale_rad, mlp, period_s);
        let mut policy = Policy { actor, usage, inference, provenance, sha256: String::new() };
        // What was built from whole tensors can be serialised.
        policy.sha256 = files::sha256(&[&policy.to_bytes().unwrap_or_default()]);
        policy
    }

    /// Averages the weights of policies that one run kept, in any order; `None` if they do not come from one run.
    ///
    /// Policies late in a run differ by chance. The two means that were tried were calmer and stronger than their run's end (training
    /// log 38).
    pub fn mean(policies: &[Policy]) -> Option<Policy> {
        let last = policies.iter().max_by_key(|policy| policy.provenance.samples)?;
        let alike = |policy: &Policy| {
            let widths = |policy: &Policy| policy.actor.layers.iter().map(Layer::outputs).collect::<Vec<_>>();
            policy.provenance.seed == last.provenance.seed
                && policy.provenance.config.check_same(&last.provenance.config).is_ok()
                && policy.layout() == last.layout()
                && widths(policy) == widths(last)
        };
        if !policies.iter().all(alike) {
            return None;
        }
        let mut actor = last.actor.clone();
        for (k, layer) in actor.layers.iter_mut().enumerate() {
            let mean = |i: usize, values: fn(&Layer) -> &[f32]| {
                let sum: f64 = policies.iter().map(|policy| f64::from(values(&policy.actor.layers[k])[i])).sum();
                (sum / policies.len() as f64) as f32
            };
            layer.weight.iter_mut().enumerate().for_each(|(i, weight)| *weight = mean(i, |layer| &layer.weight));
            layer.bias.iter_mut().enumerate().for_each(|(i, bias)| *bias = mean(i, |layer| &layer.bias));
        }
        let mean_of = policies.iter().map(|policy| policy.provenance.samples).collect();
        let (layout, provenance) = (last.layout().clone(), Provenance { mean_of, ..last.provenance.clone() });
        Some(Self::assemble(actor, layout, *last.nominal_pose(), last.scale_rad(), provenance, last.usage.clone()))
    }

    methods! {
        /// Returns the layout of the observation.
        fn layout(&self) -> &Layout = &self.inference.layout;
        /// Returns the joint targets at action zero \[rad\].
        fn nominal_pose(&self) -> &Joints = &self.inference.action.nominal_pose;
        /// Returns the change of the joint target per unit of action \[rad\].
        fn scale_rad(&self) -> f64 = self.inference.action.scale_rad[0];
        /// Returns the inference from states to joint targets.
        fn inference(&self) -> &Inference = &self.inference;
        /// Returns the joint targets \[rad\] for an observation in physical units, shape (length of the layout).
        ///
        /// # Panics
        /// The observation has another length.
        fn joint_targets(&self, observation: &[f64], buffers: &mut InferenceBuffers) -> Joints =
            self.inference.joint_targets(observation, buffers);
        /// Returns the SHA-256 of the policy file, which identifies it.
        fn sha256(&self) -> &str = &self.sha256;
    }

    /// Serialises the policy to the bytes of a policy file.
    ///
    /// # Errors
    /// The weights do not fit their shapes.
    pub fn to_bytes(&self) -> Result<Vec<u8>, safetensors::SafeTensorError> {
        let mut all = StoredTensor::of_network(self.actor.tensors("policy."));
        let (observations, targets) = self.golden();
        let length = self.layout().length();
        all.push(StoredTensor::f64("normaliser.offset", vec![length], self.layout().offset()));
        all.push(StoredTensor::f64("normaliser.scale", vec![length], self.layout().scale()));
        all.push(StoredTensor::f64("golden.observation", vec![GOLDEN, length], &observations));
        all.push(StoredTensor::f64("golden.joint_target", vec![GOLDEN, JOINTS], &targets));
        tensors::serialize(&all, self.metadata_json())
    }

    /// Formats the metadata as JSON.
    pub fn metadata_json(&self) -> String {
        let metadata = PolicyMetadata {
            format: FORMAT,
            observation: block_infos(self.layout()),
            joints: joint_names().to_vec(),
            nominal_pose_rad: *self.nominal_pose(),
            scale_rad: self.scale_rad(),
            simulation: self.provenance.config.simulation.clone(),
            provenance: self.provenance.clone(),
            usage: self.usage.clone(),
        };
        // Plain structs of finite numbers and strings: serialising them cannot fail.
        serde_json::to_string(&metadata).unwrap_or_default()
    }

    /// Writes the policy file atomically.
    ///
    /// # Errors
    /// The file cannot be written, for example because the disk is full.
    pub fn save(&self, path: &Path) -> Result<(), FileError> {
        let bytes = self.to_bytes().map_err(FileError::of(POLICY, path))?;
        files::write_atomically(path, &bytes).map_err(FileError::of(POLICY, path))
    }

    /// Reads a policy file and checks all of it, including the stored joint targets.
    ///
    /// # Errors
    /// The file cannot be read, is damaged, or has another format; the error says what was found and what was expected.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(FileError::of(POLICY, path))?;
        Self::from_bytes(&bytes, path)
    }

    /// Reads a policy from memory like [`Policy::load`]; `path` is for error messages.
    ///
    /// # Errors
    /// The bytes are damaged or have another format; the error says what was found and what was expected.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, FileError> {
        Self::parse(bytes).map_err(FileError::of(POLICY, path))
    }

    fn parse(bytes: &[u8]) -> Result<Self, PolicyFileFault> {
        let read = tensors::deserialize(bytes);
        if matches!(read, Err(TensorError::Broken(_))) && pytorch::is_pytorch(bytes) {
            return Err(PolicyFileFault::PyTorch);
        }
        let (tensors, json) = read?;
        let metadata: PolicyMetadata = tensors::metadata(&json, FORMAT)?;
        let layout = metadata.check()?;
        let length = layout.length();

        let read = |name: &str, shape: &[usize]| tensors::read_f64(&tensors, name, shape);
        let (offset, scale) = (read("normaliser.offset", &[length])?, read("normaliser.scale", &[length])?);
        let layout = layout.with_normaliser(offset, scale)?;
        let network = tensors::read_group(&tensors, "policy.")?;
        let actor = Mlp::from_tensors(network, length, JOINTS)?;
        let PolicyMetadata { nominal_pose_rad, scale_rad, provenance, usage, .. } = metadata;
        let (mlp, simulation) = (Network::Mlp(PackedMlp::new(&actor)), &provenance.config.simulation);
        let inference = Inference::new(layout, nominal_pose_rad, scale_rad, mlp, simulation.policy_period_s());
        let policy = Policy { actor, inference, provenance, usage, sha256: files::sha256(&[bytes]) };
        let observations = read("golden.observation", &[GOLDEN, length])?;
        let expected = read("golden.joint_target", &[GOLDEN, JOINTS])?;
        let found = policy.targets_of(&observations);
        let worst = numbers::largest_magnitude(found.iter().zip(&expected).map(|(a, b)| a - b));
        ensure!(worst.is_finite(), PolicyFileFault::GoldenNotFinite);
        ensure!(worst <= GOLDEN_TOLERANCE, PolicyFileFault::Golden { worst });
        Ok(policy)
    }

    fn targets_of(&self, observations: &[f64]) -> Vec<f64> {
        let mut buffers = InferenceBuffers::default();
        let rows = observations.chunks_exact(self.layout().length());
        rows.flat_map(|row| self.joint_targets(row, &mut buffers)).collect()
    }

    /// Returns plausible observations and their joint targets.
    fn golden(&self) -> (Vec<f64>, Vec<f64>) {
        let mut rng = stream(0, Purpose::Weights, u64::MAX, 0);
        let (layout, length) = (self.layout(), self.layout().length());
        let observations: Vec<f64> = (0..GOLDEN * length)
            .map(|k| {
                let (offset, scale) = (layout.offset()[k % length], layout.scale()[k % length]);
                offset + 0.5 * rng.sample::<f64, _>(StandardNormal) / scale
            })
            .collect();
        let targets = self.targets_of(&observations);
        (observations, targets)
    }
}

/// A fault in the content of a policy file.
#[derive(Debug, thiserror::Error)]
enum PolicyFileFault {
    #[error(transparent)]
    Tensors(#[from] TensorError),
    #[error("{}", pytorch::ADVICE)]
    PyTorch,
    #[error("its policy: {0}")]
    Network(#[from] NetworkError),
    #[error(transparent)]
    Config(#[from] ValueError),
    #[error(transparent)]
    Observation(#[from] LayoutError),
    #[error(
        "it describes {described} numbers of the observation and names {named}, its configuration has {configured}"
    )]
    Length { described: usize, named: usize, configured: usize },
    #[error("its joints are {0:?}, expected {expected:?}", expected = joint_names())]
    Joints(Vec<String>),
    #[error("its nominal pose or scale is not finite")]
    Action,
    #[error("its simulation differs from that of the configuration it was trained with")]
    Simulation,
    #[error("its network returns numbers that are not finite for its golden observations")]
    GoldenNotFinite,
    #[error(
        "its golden joint targets are off by {worst:.2e} rad, at most {GOLDEN_TOLERANCE:.0e} is expected: the file is damaged"
    )]
    Golden { worst: f64 },
}

impl PolicyMetadata {
    /// Checks the metadata and returns the layout of the observation.
    fn check(&self) -> Result<Layout, PolicyFileFault> {
        let config = &self.provenance.config;
        config.check()?;
        let layout = config.layout()?;
        let (named, configured) = (self.usage.observation_elements.len(), layout.length());
        // The file may state any lengths, so the sum saturates.
        let described = self.observation.iter().fold(0_usize, |sum, block| sum.saturating_add(block.length));
        ensure!([named, described] == [configured; 2], PolicyFileFault::Length { described, named, configured });
        ensure!(self.joints == joint_names(), PolicyFileFault::Joints(self.joints.clone()));
        if !numbers::finite_in_single(&self.nominal_pose_rad) || !numbers::finite_in_single(&[self.scale_rad]) {
            return Err(PolicyFileFault::Action);
        }
        ensure!(self.simulation == config.simulation, PolicyFileFault::Simulation);
        Ok(layout)
    }
}

/// Describes the blocks of an observation.
fn block_infos(layout: &Layout) -> Vec<BlockInfo> {
    let mut infos = Vec::new();
    for block in layout.blocks() {
        infos.extend(block.steps_ago.iter().map(|age| BlockInfo {
            quantity: block.quantity.to_string(),
            age: *age,
            length: block.length() / block.steps_ago.len(),
            unit: block.unit().to_owned(),
        }));
    }
    infos
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::policy::onnx::OnnxNetwork;

    /// A policy on the Go1 that was not trained.
    pub(crate) fn untrained(network: &ActorCritic, config: Config) -> Policy {
        let layout = config.layout().unwrap();
        let (git_revision, mujoco_version, config_name) = ("test".into(), "2.2.2".into(), "compliant".into());
        let provenance =
            Provenance { config_name, config, seed: 5, samples: 0, git_revision, mujoco_version, mean_of: vec![] };
        Policy::new(network, &Robot::load("go1").unwrap(), layout, provenance)
    }

    fn policy() -> Policy {
        let config = Config::load("compliant").unwrap();
        let mut rng = stream(5, Purpose::Weights, 0, 0);
        let inputs = config.layout().unwrap().length();
        untrained(&ActorCritic::orthogonal(inputs, &[32, 16], JOINTS, -1.0, &mut rng), config)
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
    fn the_mean_of_a_runs_policies_has_the_mean_of_their_weights() {
        let (mut first, mut last) = (policy(), policy());
        (first.provenance.samples, last.provenance.samples) = (100, 200);
        first.actor.layers[0].weight[3] = 1.0;
        last.actor.layers[0].weight[3] = 2.0;
        first.actor.layers[2].bias[11] = -1.0;
        let mean = Policy::mean(&[last, first]).unwrap();
        assert_eq!((mean.actor.layers[0].weight[3], mean.actor.layers[2].bias[11]), (1.5, -0.5));
        assert_eq!(mean.actor.layers[1], policy().actor.layers[1]);
        assert_eq!((mean.provenance.samples, mean.provenance.mean_of.as_slice()), (200, &[200, 100][..]));
        // Its golden joint targets are its own: reading computes them again.
        let read = Policy::from_bytes(&mean.to_bytes().unwrap(), Path::new("mean")).unwrap();
        assert_eq!(read.provenance, mean.provenance);
        let mut stranger = policy();
        stranger.provenance.seed += 1;
        assert!(Policy::mean(&[read, stranger]).is_none() && Policy::mean(&[]).is_none());
    }

    #[test]
    fn the_identity_of_a_policy_is_that_of_its_file_whatever_its_format() {
        for (name, bytes) in crate::policy::shipped::EMBEDDED {
            let policy = Policy::from_bytes(bytes, Path::new(name)).unwrap();
            assert_eq!(policy.sha256(), files::sha256(&[bytes]), "{name}");
        }
        let policy = policy();
        assert_eq!(policy.sha256(), files::sha256(&[&policy.to_bytes().unwrap()]));
    }

    #[test]
    fn newer_format_is_refused_by_name() {
        let mut newer = policy().to_bytes().unwrap();
        let at = newer.windows(12).position(|window| window == br#"\"format\":1"#).unwrap();
        newer[at + 11] = b'9';
        let error = Policy::from_bytes(&newer, Path::new("newer")).unwrap_err().to_string();
        assert!(error.contains("its format is 9, this program reads 1"), "{error}");
    }

    #[test]
    fn key_of_another_version_is_explained_and_unwritten_at_its_default() {
        assert!(!policy().metadata_json().contains("friction_loss_n_m"));
        let mut newer = policy().to_bytes().unwrap();
        let at = newer.windows(6).position(|window| window == b"flight").unwrap();
        newer[at..at + 6].copy_from_slice(b"warmth");
        let error = Policy::from_bytes(&newer, Path::new("newer")).unwrap_err().to_string();
        let expected =
            "provenance.config.reward.warmth: unknown field `warmth`: another version of Supple wrote this file";
        assert!(error.contains(expected), "{error}");
    }

    #[test]
    fn a_file_of_pytorch_is_told_from_a_damaged_one() {
        // A zip archive as torch.save writes it, and the pickle of older versions.
        for bytes in [&b"PK\x03\x04\x00\x00\x08\x08archive/data.pkl"[..], b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."] {
            let policy = Policy::from_bytes(bytes, Path::new("p.pt")).unwrap_err().to_string();
            let network = OnnxNetwork::from_bytes(bytes, Path::new("p.onnx")).unwrap_err().to_string();
            let advice = "torch.onnx.export";
            assert!(policy.contains(advice) && network.contains(advice), "{policy} {network}");
        }
    }

    #[test]
    fn observation_of_other_lengths_is_refused() {
        let mut metadata: PolicyMetadata = serde_json::from_str(&policy().metadata_json()).unwrap();
        // Their sum is beyond the largest number.
        metadata.observation[..2].iter_mut().for_each(|block| block.length = usize::MAX);
        let error = metadata.check().unwrap_err().to_string();
        assert!(error.starts_with(&format!("it describes {} numbers of the observation", usize::MAX)), "{error}");
    }

    #[test]
    fn every_truncation_is_refused_without_panic() {
        let bytes = policy().to_bytes().unwrap();
        for length in (0..bytes.len()).step_by(97) {
            assert!(Policy::from_bytes(&bytes[..length], Path::new("cut")).is_err());
        }
    }

    #[test]
    fn golden_pairs_catch_a_wrong_weight_in_every_layer() {
        let bytes = policy().to_bytes().unwrap();
        let (tensors, _) = tensors::deserialize(&bytes).unwrap();
        for name in [0, 1, 2].iter().flat_map(|k| ["weight", "bias"].map(|kind| format!("policy.{k}.{kind}"))) {
            let first = tensors.tensor(&name).unwrap().data().as_ptr() as usize - bytes.as_ptr() as usize;
            let mut damaged = bytes.clone();
            damaged[first..first + 4].copy_from_slice(&4.0_f32.to_le_bytes());
            assert!(Policy::from_bytes(&damaged, Path::new("damaged")).is_err(), "{name}");
        }
    }

    #[test]
    fn a_network_of_other_dimensions_is_named() {
        let mut other = policy();
        other.actor.layers.pop();
        let error = Policy::from_bytes(&other.to_bytes().unwrap(), Path::new("other")).unwrap_err().to_string();
        assert!(error.contains("tensor `1.bias` should have shape [12], but has shape [16]"), "{error}");
    }

    #[test]
    fn nothing_that_is_not_finite_counts_as_sound() {
        let mut bytes = policy().to_bytes().unwrap();
        let scale = {
            let (tensors, _) = tensors::deserialize(&bytes).unwrap();
            tensors.tensor("normaliser.scale").unwrap().data().as_ptr() as usize - bytes.as_ptr() as usize
        };
        bytes[scale..scale + 8].copy_from_slice(&1e308_f64.to_le_bytes());
        let error = Policy::from_bytes(&bytes, Path::new("huge")).unwrap_err().to_string();
        assert!(error.contains("or the scale 1e308 of 'previous base height [m]'"), "{error}");

        let mut overflowing = policy();
        for layer in &mut overflowing.actor.layers {
            layer.weight.fill(1e38);
        }
        let error = Policy::from_bytes(&overflowing.to_bytes().unwrap(), Path::new("huge")).unwrap_err().to_string();
        assert!(error.contains("numbers that are not finite"), "{error}");
    }
}

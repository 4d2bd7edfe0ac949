/*! The contact network and its file: tensors (weights, normaliser) and JSON (meaning of the numbers, provenance,
scores).

All tensors are under a checksum, because one wrong bit would change the estimates silently.
*/

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{INPUTS, RATE_HZ, TICKS};
use crate::estimate::SensorNoise;
use crate::network::{Mlp, NetworkError, PackedMlp, Scratch};
use crate::robot::{JOINTS, LEGS, joint_names};
use crate::util::files::{self, FileError};
use crate::util::tensors::{self, StoredTensor, TensorError};

/// Version of the file format.
const FORMAT: u32 = 1;

/// Name of the file type in error messages.
const CONTACT: &str = "contact network";

/// Maximum size of a contact network's file \[bytes\].
const MAX_BYTES: u64 = 16 << 20;

/// The file of the shipped network.
const SHIPPED: &[u8] = include_bytes!("../../../models/contact.safetensors");

/// Returns the SHA-256 of the shipped file.
pub fn shipped_sha256() -> String {
    files::sha256(&[SHIPPED])
}

/// A policy whose walking produced the training data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicySource {
    /// Name of the policy as given on the command line.
    pub name: String,
    /// SHA-256 of the policy file.
    pub sha256: String,
}

/// Accuracy of the network for one foot, in episodes that it was not trained on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct HeldOut {
    pub precision: f64,
    pub recall: f64,
    pub f1: f64,
}

/// Origin of a contact network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContactProvenance {
    /// The policies whose walking produced the data.
    pub policies: Vec<PolicySource>,
    /// Seed of episodes, noise and training.
    pub seed: u64,
    /// Number of training episodes, all policies together.
    pub training_episodes: usize,
    /// Number of training samples (ticks of 240 Hz).
    pub training_samples: usize,
    /// Number of episodes held out for the scores.
    pub held_out_episodes: usize,
    /// Scores in the held-out episodes, one for each foot in the order of [`LEGS`].
    pub held_out: Vec<HeldOut>,
    /// Sensor noise in the data.
    pub noise: SensorNoise,
    /// Git revision of the program that trained it.
    pub git_revision: String,
    /// MuJoCo version that simulated the data.
    pub mujoco_version: String,
}

/// Description of one third of a tick's inputs (angles, rates or targets), for other programs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct InputInfo {
    quantity: String,
    unit: String,
    length: usize,
}

/// The JSON under the metadata key `supple`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct ContactMetadata {
    format: u32,
    rate_hz: f64,
    /// Number of ticks in the input, oldest first; each has all of `inputs`.
    ticks: usize,
    inputs: Vec<InputInfo>,
    joints: Vec<String>,
    /// Meaning of each output: a foot is in contact if its logit is above zero.
    outputs: Vec<String>,
    /// SHA-256 of all tensors.
    checksum: String,
    provenance: ContactProvenance,
}

/// A trained network, its normaliser and its origin.
#[derive(Debug)]
pub struct ContactNetwork {
    /// The network from normalised inputs to a logit for each foot.
    pub mlp: Mlp,
    /// Mean of each input in training, physical units.
    pub offset: Vec<f32>,
    /// Inverse standard deviation of each input in training.
    pub scale: Vec<f32>,
    /// Origin of the network: data, seed and scores.
    pub provenance: ContactProvenance,
    packed: PackedMlp,
}

impl ContactNetwork {
    /// Assembles the network and its normaliser.
    ///
    /// # Panics
    /// The network does not map 144 numbers to 4, or the normaliser has another length.
    pub fn new(mlp: Mlp, offset: Vec<f32>, scale: Vec<f32>, provenance: ContactProvenance) -> Self {
        assert_eq!((mlp.inputs(), mlp.outputs()), (INPUTS, 4), "a contact network leads from 144 numbers to 4");
        assert_eq!((offset.len(), scale.len()), (INPUTS, INPUTS), "every input has an offset and a scale");
        ContactNetwork { packed: PackedMlp::new(&mlp), mlp, offset, scale, provenance }
    }

    /// Loads the network inside the program.
    ///
    /// # Errors
    /// The program was built with a damaged file.
    pub fn shipped() -> Result<Self, FileError> {
        Self::from_bytes(SHIPPED, Path::new("models/contact.safetensors"))
    }

    /// Returns a warning that names the policies (name and SHA-256) whose gait the network was not trained on, if any.
    pub fn unfamiliar<'a>(&self, policies: impl IntoIterator<Item = (String, &'a str)>) -> Option<String> {
        let known = |sha256: &str| self.provenance.policies.iter().any(|policy| policy.sha256 == sha256);
        let strangers: Vec<String> =
            policies.into_iter().filter(|(_, sha256)| !known(sha256)).map(|(name, _)| name).collect();
        (!strangers.is_empty()).then(|| {
            format!(
                "the contact network was not trained on how {} walks and may miss contacts; train_contact trains one",
                strangers.join(", ")
            )
        })
    }

    /// Returns the logit of contact for each foot, in the order of [`crate::robot::LEGS`], for the inputs of a
    /// [`ContactHistory`](super::ContactHistory).
    pub fn logits(&self, inputs: &[f32; INPUTS], scratch: &mut Scratch) -> [f32; 4] {
        let seen: [f32; INPUTS] = std::array::from_fn(|k| (inputs[k] - self.offset[k]) * self.scale[k]);
        let mut logits = [0.0; 4];
        self.packed.forward(1, &seen, &mut logits, scratch);
        logits
    }

    /// Serialises the file.
    ///
    /// # Errors
    /// A layer's shape does not fit its weights.
    pub fn to_bytes(&self) -> Result<Vec<u8>, safetensors::SafeTensorError> {
        let mut all = StoredTensor::of_network(self.mlp.tensors("contact."));
        all.push(StoredTensor::f32("normaliser.offset", vec![INPUTS], &self.offset));
        all.push(StoredTensor::f32("normaliser.scale", vec![INPUTS], &self.scale));
        let (format, rate_hz, inputs, joints) = (FORMAT, RATE_HZ, inputs(), joint_names().to_vec());
        let (outputs, checksum) = (LEGS.map(ToOwned::to_owned).to_vec(), self.checksum());
        let provenance = self.provenance.clone();
        let metadata = ContactMetadata { format, rate_hz, ticks: TICKS, inputs, joints, outputs, checksum, provenance };
        // Plain structs of finite numbers and strings: serialising them cannot fail.
        tensors::serialize(&all, serde_json::to_string(&metadata).unwrap_or_default())
    }

    /// Writes the file atomically.
    ///
    /// # Errors
    /// The weights do not fit their shapes, or the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FileError> {
        let bytes = self.to_bytes().map_err(FileError::of(CONTACT, path))?;
        files::write_atomically(path, &bytes).map_err(FileError::of(CONTACT, path))
    }

    /// Reads a file and checks all of it.
    ///
    /// # Errors
    /// The file cannot be read, is damaged, or has another format; the error says what was found and what was expected.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(FileError::of(CONTACT, path))?;
        Self::from_bytes(&bytes, path)
    }

    /// Reads the network from memory like [`ContactNetwork::load`]; `path` is for error messages.
    ///
    /// # Errors
    /// The bytes are damaged or have another format.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, FileError> {
        let advice =
            |fault: ContactFileFault| format!("{fault}; train one with `cargo run --release --bin train_contact`");
        parse(bytes).map_err(advice).map_err(FileError::of(CONTACT, path))
    }

    /// Returns the SHA-256 of weights and normaliser, which identifies the network.
    pub fn checksum(&self) -> String {
        let of = |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|value| value.to_le_bytes()).collect() };
        let layers = self.mlp.layers.iter().flat_map(|layer| [of(&layer.weight), of(&layer.bias)]);
        let parts: Vec<Vec<u8>> = layers.chain([of(&self.offset), of(&self.scale)]).collect();
        files::sha256(&parts.iter().map(Vec::as_slice).collect::<Vec<_>>())
    }
}

fn inputs() -> Vec<InputInfo> {
    [("joint_angles", "rad"), ("joint_rates", "rad/s"), ("joint_targets", "rad")]
        .map(|(quantity, unit)| InputInfo { quantity: quantity.into(), unit: unit.into(), length: JOINTS })
        .to_vec()
}

/// A fault in the content of a contact network's file.
#[derive(Debug, thiserror::Error)]
enum ContactFileFault {
    #[error(transparent)]
    Tensors(#[from] TensorError),
    #[error("its network: {0}")]
    Network(#[from] NetworkError),
    #[error("its {key} is {found}, expected {expected}")]
    Value { key: &'static str, found: String, expected: String },
    #[error("its inputs are {0:?}")]
    Inputs(Vec<InputInfo>),
    #[error("its tensors have checksum {found}, expected {expected}: it is damaged")]
    Damaged { found: String, expected: String },
}

fn parse(bytes: &[u8]) -> Result<ContactNetwork, ContactFileFault> {
    let (tensors, json) = tensors::deserialize(bytes)?;
    let metadata: ContactMetadata = serde_json::from_str(&json).map_err(TensorError::Metadata)?;
    metadata.check()?;
    let network = tensors::read_group(&tensors, "contact.")?;
    let mlp = Mlp::from_tensors(network, INPUTS, LEGS.len())?;
    let offset = tensors::read_f32(&tensors, "normaliser.offset", &[INPUTS])?;
    let scale = tensors::read_f32(&tensors, "normaliser.scale", &[INPUTS])?;
    let network = ContactNetwork::new(mlp, offset, scale, metadata.provenance);
    let found = network.checksum();
    ensure!(found == metadata.checksum, ContactFileFault::Damaged { found, expected: metadata.checksum });
    Ok(network)
}

impl ContactMetadata {
    fn check(&self) -> Result<(), ContactFileFault> {
        let expect = |key: &'static str, found: String, expected: String| {
            if found == expected { Ok(()) } else { Err(ContactFileFault::Value { key, found, expected }) }
        };
        expect("format", self.format.to_string(), FORMAT.to_string())?;
        expect("rate", format!("{} Hz", self.rate_hz), format!("{RATE_HZ} Hz"))?;
        expect("number of ticks", self.ticks.to_string(), TICKS.to_string())?;
        let joints: Vec<String> = joint_names().to_vec();
        expect("list of joints", format!("{:?}", self.joints), format!("{joints:?}"))?;
        expect("list of outputs", format!("{:?}", self.outputs), format!("{LEGS:?}"))?;
        let scores = self.provenance.held_out.len();
        expect("number of scored feet", scores.to_string(), LEGS.len().to_string())?;
        if self.inputs == inputs() { Ok(()) } else { Err(ContactFileFault::Inputs(self.inputs.clone())) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Layer;
    use crate::util::random::{Purpose, stream};

    fn network() -> ContactNetwork {
        let mut rng = stream(3, Purpose::Weights, 0, 0);
        let layers = [(INPUTS, 8), (8, 4)].map(|(from, to)| Layer::orthogonal(from, to, 1.0, &mut rng)).to_vec();
        let provenance = ContactProvenance {
            policies: vec![PolicySource { name: "test".into(), sha256: "0".into() }],
            seed: 3,
            training_episodes: 1,
            training_samples: 2,
            held_out_episodes: 1,
            held_out: vec![HeldOut { precision: 0.5, recall: 1.0, f1: 2.0 / 3.0 }; 4],
            noise: SensorNoise::default(),
            git_revision: "test".into(),
            mujoco_version: "2.2.2".into(),
        };
        ContactNetwork::new(Mlp { layers }, vec![0.5; INPUTS], vec![2.0; INPUTS], provenance)
    }

    fn refusal(bytes: &[u8]) -> String {
        ContactNetwork::from_bytes(bytes, Path::new("test")).unwrap_err().to_string()
    }

    #[test]
    fn a_network_survives_its_file_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("contact.safetensors");
        let network = network();
        network.save(&path).unwrap();
        let read = ContactNetwork::load(&path).unwrap();
        assert_eq!((&read.mlp, &read.offset, &read.scale), (&network.mlp, &network.offset, &network.scale));
        assert_eq!(read.provenance, network.provenance);
        assert_eq!(read.to_bytes().unwrap(), std::fs::read(&path).unwrap());
    }

    #[test]
    fn every_truncation_and_every_flipped_weight_is_refused() {
        let bytes = network().to_bytes().unwrap();
        for length in (0..bytes.len()).step_by(61) {
            assert!(ContactNetwork::from_bytes(&bytes[..length], Path::new("cut")).is_err());
        }
        let tensors = 4 * (INPUTS * 8 + 8 + 8 * 4 + 4 + 2 * INPUTS);
        for position in (bytes.len() - tensors..bytes.len()).step_by(101) {
            let mut damaged = bytes.clone();
            damaged[position] ^= 1;
            assert!(refusal(&damaged).contains("it is damaged"), "byte {position}");
        }
    }

    #[test]
    fn other_networks_and_rates_are_named() {
        let bytes = network().to_bytes().unwrap();
        let changed = |from: &str, to: &str| {
            assert_eq!(from.len(), to.len());
            let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
            refusal(&[&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat())
        };
        assert!(changed(r#"rate_hz\":240"#, r#"rate_hz\":120"#).contains("its rate is 120 Hz, expected 240 Hz"));
        assert!(changed(r#"format\":1"#, r#"format\":9"#).contains("its format is 9, expected 1"));
        assert!(changed("FL_hip", "FL_hop").contains("its list of joints is"));
        assert!(refusal(b"no such thing").contains("was it cut off"));
        let missing = ContactNetwork::load(Path::new("nowhere/contact.safetensors")).unwrap_err().to_string();
        assert!(missing.contains("nowhere/contact.safetensors"), "{missing}");
    }

    #[test]
    fn shipped_network_reaches_stated_scores() {
        let network = ContactNetwork::shipped().unwrap();
        assert!(network.provenance.held_out.iter().all(|foot| foot.f1 > 0.95), "{:?}", network.provenance.held_out);
        // With any inputs the answer is a number.
        let logits = network.logits(&[0.0; INPUTS], &mut Scratch::default());
        assert!(logits.iter().all(|logit| logit.is_finite()));
    }
}

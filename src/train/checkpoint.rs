/*! Checkpoints: the complete state of a run, from which it continues with the same bits, in one atomic file.

The tensors are the learner's (parameters and Adam's moments) and `run`: the bytes of a JSON text, exact to the bit. It holds the rest
(configuration, seed, counters, curriculum, the state of every environment). A checksum protects both. The previous checkpoint is kept: if
the newest cannot be read, the run resumes from that one and reports it.
*/

use std::path::Path;

use safetensors::{SafeTensorError, SafeTensors};
use serde::{Deserialize, Serialize};

use crate::config::{Config, ValueError};
use crate::network::{ActorCritic, NetworkError};
use crate::ppo::LearnerState;
use crate::train::Curriculum;
use crate::train::environment::EnvState;
use crate::util::files::{self, FileError};
use crate::util::tensors::{self, StoredTensor, TensorError};

/// File of the newest checkpoint in a run's folder.
pub const NEWEST: &str = "checkpoint.safetensors";

/// File of the previous checkpoint.
pub const PREVIOUS: &str = "checkpoint.previous.safetensors";

/// File of a newest checkpoint that could not be read and was set aside.
pub const DAMAGED: &str = "checkpoint.damaged.safetensors";

/// Version of the format that is written.
const FORMAT: u32 = 3;

/// Name of the tensor with the bytes of the [`RunState`] as JSON.
const RUN: &str = "run";

/// Name of the file type in error messages.
const CHECKPOINT: &str = "checkpoint";

/// Maximum size of a checkpoint \[bytes\].
const MAX_BYTES: u64 = 4 << 30;

/// The reason why the bytes of a checkpoint are refused.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file is cut off or foreign, or a tensor is invalid.
    #[error(transparent)]
    Tensors(TensorError),
    /// The file has another version of the format.
    #[error(
        "its format is {0}, this program reads {FORMAT}: resume with the version of Supple that wrote it, or train anew with \
         --config and the config.yaml beside it"
    )]
    Format(u32),
    /// The state of the run is no JSON of this version.
    #[error("its run state does not parse: {0}")]
    Run(serde_json::Error),
    /// The configuration of the run is invalid.
    #[error(transparent)]
    Config(#[from] ValueError),
    /// An open fraction of the curriculum is invalid.
    #[error("its curriculum.{name} is {found}, expected 0 to 1")]
    Curriculum {
        /// Name of the fraction.
        name: &'static str,
        /// The value that was found.
        found: f64,
    },
    /// The tensors of a group, such as `first_moment`, are no policy and value function.
    #[error("{0}: {1}")]
    Network(&'static str, NetworkError),
    /// A bit of the file has changed.
    #[error("its checksum does not match: the file is damaged")]
    Damaged,
}

impl From<TensorError> for CheckpointError {
    fn from(error: TensorError) -> Self {
        match error {
            TensorError::Format { found, .. } => CheckpointError::Format(found),
            error => CheckpointError::Tensors(error),
        }
    }
}

/// The state of a run after a whole number of iterations.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// State of the run, without tensors.
    pub run: RunState,
    /// State of the learner.
    pub learner: LearnerState,
}

/// The state of a run without tensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunState {
    /// Name of the configuration.
    pub config_name: String,
    /// Configuration of the run.
    #[serde(serialize_with = "crate::util::yaml::serialize_without_defaults")]
    pub config: Config,
    /// Git revision of the program that wrote the checkpoint.
    pub git_revision: String,
    /// MuJoCo that it was written with, as [`mujoco_version`](crate::provenance::mujoco_version) names it; empty if unknown.
    #[serde(default)]
    pub mujoco_version: String,
    /// SHA-256 of the robot's files.
    pub robot_sha256: String,
    /// Seed of the run.
    pub seed: u64,
    /// Number of finished iterations.
    pub iteration: u64,
    /// Number of samples collected.
    pub samples: u64,
    /// Wall-clock time spent training, over all sessions \[s\].
    pub elapsed_s: f64,
    /// State of the curriculum.
    pub curriculum: Curriculum,
    /// State of every environment, in the middle of its episode.
    pub environments: Vec<EnvState>,
}

#[derive(Serialize, Deserialize)]
struct Metadata {
    format: u32,
    /// Checksum of the run's JSON and the parameters' and moments' bytes.
    sha256: String,
    optimiser_steps: u64,
    learning_rate: f64,
}

impl Checkpoint {
    /// Writes the checkpoint into a run's folder; the newest one there becomes the previous one.
    ///
    /// # Errors
    /// A file cannot be written, for example because the disk is full; older checkpoints stay untouched.
    pub fn save(&self, folder: &Path) -> Result<(), FileError> {
        let (newest, previous) = (folder.join(NEWEST), folder.join(PREVIOUS));
        let bytes = self.to_bytes().map_err(FileError::of(CHECKPOINT, &newest))?;
        files::write_keeping(&newest, &previous, &bytes).map_err(FileError::of(CHECKPOINT, &newest))
    }

    /// Reads the newest checkpoint of a run's folder, or else the previous one with the error of the newest.
    ///
    /// # Errors
    /// Neither checkpoint can be read; the error is that of the newest.
    pub fn load(folder: &Path) -> Result<(Self, Option<FileError>), FileError> {
        match Self::load_file(&folder.join(NEWEST)) {
            Ok(checkpoint) => Ok((checkpoint, None)),
            Err(error) => match Self::load_file(&folder.join(PREVIOUS)) {
                Ok(checkpoint) => Ok((checkpoint, Some(error))),
                Err(_) => Err(error),
            },
        }
    }

    fn load_file(path: &Path) -> Result<Self, FileError> {
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(FileError::of(CHECKPOINT, path))?;
        Self::from_bytes(&bytes).map_err(FileError::of(CHECKPOINT, path))
    }

    /// Serialises the checkpoint to the bytes of a file.
    ///
    /// # Errors
    /// The state cannot be written as JSON, or a tensor does not fit its shape.
    pub fn to_bytes(&self) -> Result<Vec<u8>, SafeTensorError> {
        let run = serde_json::to_vec(&self.run)?;
        let mut all = Vec::new();
        for (group, networks) in self.groups() {
            for (name, shape, values) in networks.tensors() {
                all.push(StoredTensor::f32(format!("{group}.{name}"), shape, values));
            }
        }
        let (sha256, optimiser_steps) = (checksum(&run, &self.learner), self.learner.steps);
        let metadata = Metadata { format: FORMAT, sha256, optimiser_steps, learning_rate: self.learner.learning_rate };
        all.push(StoredTensor::u8(RUN, run));
        tensors::serialize(&all, serde_json::to_string(&metadata)?)
    }

    /// Reads the bytes that [`Checkpoint::to_bytes`] returned.
    ///
    /// # Errors
    /// The bytes are damaged, of another format, or inconsistent.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        let (tensors, json) = tensors::deserialize(bytes)?;
        let metadata: Metadata = tensors::metadata(&json, FORMAT)?;
        let json = tensors::read_u8(&tensors, RUN)?;
        let (parameters, first_moment) = (read_group(&tensors, "parameters")?, read_group(&tensors, "first_moment")?);
        let (second_moment, steps) = (read_group(&tensors, "second_moment")?, metadata.optimiser_steps);
        let learning_rate = metadata.learning_rate;
        let learner = LearnerState { parameters, first_moment, second_moment, steps, learning_rate };
        ensure!(checksum(json, &learner) == metadata.sha256, CheckpointError::Damaged);
        let run: RunState = tensors::from_json(json).map_err(CheckpointError::Run)?;
        run.config.check()?;
        let Curriculum { command_fraction, force_fraction, .. } = run.curriculum;
        for (name, found) in [("command_fraction", command_fraction), ("force_fraction", force_fraction)] {
            ensure!((0.0..=1.0).contains(&found), CheckpointError::Curriculum { name, found });
        }
        Ok(Checkpoint { run, learner })
    }

    fn groups(&self) -> [(&'static str, &ActorCritic); 3] {
        groups(&self.learner)
    }
}

fn groups(learner: &LearnerState) -> [(&'static str, &ActorCritic); 3] {
    [
        ("parameters", &learner.parameters),
        ("first_moment", &learner.first_moment),
        ("second_moment", &learner.second_moment),
    ]
}

fn checksum(run: &[u8], learner: &LearnerState) -> String {
    let mut bytes = run.to_vec();
    bytes.extend(learner.steps.to_le_bytes());
    bytes.extend(learner.learning_rate.to_le_bytes());
    for (_, networks) in groups(learner) {
        for (_, _, values) in networks.tensors() {
            bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        }
    }
    files::sha256(&[&bytes])
}

fn read_group(tensors: &SafeTensors<'_>, group: &'static str) -> Result<ActorCritic, CheckpointError> {
    let named = tensors::read_group(tensors, &format!("{group}."))?;
    ActorCritic::from_tensors(named).map_err(|error| CheckpointError::Network(group, error))
}

/*! Policies from elsewhere: an ONNX network, and a YAML file that says what it sees and what its outputs mean.

The YAML file is the policy: it names its ONNX file, and everything that takes a policy takes it. Two examples with every
key explained are `examples/policies/rsl_rl.yaml` and `examples/policies/playground.yaml`. An observation is a list of
[`Quantity`]s, each `(value − offset) · scale`, clipped, of now or of steps ago; an action becomes joint targets for the
PD law with the gains, rates and latency that the policy was trained with.
*/

mod controller;
mod describe;
mod spec;

use std::path::{Path, PathBuf};

pub use controller::ForeignController;
pub use describe::{describe, is_described_by_us};
pub use spec::{Block, Quantity};

use crate::config::{Config, ConfigError};
use crate::files;
use crate::go1::Joints;
use crate::onnx::{Network, OnnxError};

/// Larger files are not descriptions of a policy.
const MAX_BYTES: u64 = 256 << 10;

/// Why a policy from elsewhere was refused.
#[derive(Debug, thiserror::Error)]
pub enum ForeignError {
    /// Reading failed.
    #[error("policy {}: {source}", path.display())]
    Io {
        /// The YAML file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Not YAML, an unknown key, a missing key, or simulation settings out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// What it says does not describe a policy for this robot and this network.
    #[error("policy {}: {problem}", path.display())]
    Invalid {
        /// The YAML file.
        path: PathBuf,
        /// What was found and expected.
        problem: String,
    },
    /// The network.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
}

/// What an output of the network is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Meaning {
    /// Joint target = nominal pose + scale · output.
    OffsetFromNominal,
    /// Joint target = scale · output.
    JointAngle,
}

/// A policy from elsewhere.
#[derive(Debug)]
pub struct ForeignPolicy {
    network: Network,
    parts: spec::Parts,
    /// SHA-256 of the YAML file and the ONNX file.
    pub sha256: String,
}

impl ForeignPolicy {
    /// Reads the YAML file and the ONNX file that it names.
    ///
    /// # Errors
    /// [`ForeignError`] that says what was found and what was expected.
    pub fn load(path: &Path) -> Result<Self, ForeignError> {
        let io = |path: &Path, source| ForeignError::Io { path: path.to_owned(), source };
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(|source| io(path, source))?;
        let text = String::from_utf8_lossy(&bytes);
        let spec = spec::Spec::parse(path, &text)?;
        let onnx = path.parent().unwrap_or(Path::new("")).join(&spec.onnx);
        let network_bytes = files::read_bounded(&onnx, crate::onnx::MAX_BYTES).map_err(|source| io(&onnx, source))?;
        let network = Network::from_bytes(&network_bytes, &onnx)?;
        let sha256 = files::sha256(&[&bytes, &network_bytes]);
        spec.with_network(path, network, sha256)
    }

    /// Joint targets at rest, in our order \[rad\].
    pub fn nominal_pose(&self) -> Joints {
        self.parts.nominal_pose
    }

    /// Rates, gains and latency to run it with; all else is that of the paper's configuration.
    pub fn config(&self) -> &Config {
        &self.parts.config
    }
}

/*! External policies: an ONNX network, and a YAML file that says what it sees and what its outputs mean.

The YAML file is the policy: it names its ONNX file, and everything that takes a policy takes it. Two examples with every
key explained are `examples/policies/rsl_rl.yaml` and `examples/policies/playground.yaml`. An observation is a list of
[`Observed`](crate::observation::Observed) quantities as in a configuration; an action becomes joint targets for the PD law
with the gains, rates and latency that the policy was trained with.
*/

mod describe;
mod spec;

use std::path::{Path, PathBuf};

pub use describe::{describe, is_described_by_us};

use super::inference::{Inference, Network};
use super::onnx::{self, OnnxError};
use crate::config::{Config, ConfigError};
use crate::util::files;

/// Larger files are not descriptions of a policy.
const MAX_BYTES: u64 = 256 << 10;

/// Why an external policy was refused.
#[derive(Debug, thiserror::Error)]
pub enum ExternalError {
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

/// An external policy.
#[derive(Debug)]
pub struct ExternalPolicy {
    /// What turns states into joint targets.
    pub inference: Inference,
    /// Rates, gains and latency to run it with; all else is that of the paper's configuration.
    pub config: Config,
    /// SHA-256 of the YAML file and the ONNX file.
    pub sha256: String,
}

impl ExternalPolicy {
    /// Reads the YAML file and the ONNX file that it names.
    ///
    /// # Errors
    /// [`ExternalError`] that says what was found and what was expected.
    pub fn load(path: &Path) -> Result<Self, ExternalError> {
        let io = |path: &Path, source| ExternalError::Io { path: path.to_owned(), source };
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(|source| io(path, source))?;
        let spec = spec::Spec::parse(path, &String::from_utf8_lossy(&bytes))?;
        let onnx = path.parent().unwrap_or(Path::new("")).join(&spec.onnx);
        let network_bytes = files::read_bounded(&onnx, onnx::MAX_BYTES).map_err(|source| io(&onnx, source))?;
        let network = onnx::Network::from_bytes(&network_bytes, &onnx)?;
        spec.check(&network).map_err(|problem| ExternalError::Invalid { path: path.to_owned(), problem })?;
        let spec::Spec { layout, action, config, .. } = spec;
        let period_s = config.simulation.policy_period_s();
        Ok(ExternalPolicy {
            inference: Inference { layout, action, network: Network::Onnx(network), period_s },
            config,
            sha256: files::sha256(&[&bytes, &network_bytes]),
        })
    }
}

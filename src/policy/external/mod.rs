/*! External policies: an ONNX network, and a YAML file that describes its observation and its outputs.

Start with [`load`]; every program that takes a policy takes the YAML file. Two examples with every
key explained are `examples/policies/rsl_rl.yaml` and `examples/policies/playground.yaml`; [`translate`] writes one from
the file of another framework. An observation is a list of
[`Observed`](crate::observation::Observed) quantities as in a configuration; an action becomes joint targets for the PD law
with the gains, rates and latency that the policy was trained with.
*/

mod deploy;
mod describe;
mod framework;
mod metadata;
mod spec;
mod text;

use std::path::Path;

pub use describe::{describe, describe_network, is_described_by_us, translate};

use super::inference::{Inference, Network};
use super::{Agent, AgentError, onnx};
use crate::util::files::{self, FileError};

/// Name of the file type in error messages.
const POLICY: &str = "policy";

/// Maximum size of a description \[bytes\].
const MAX_BYTES: u64 = 256 << 10;

/// Reads the YAML file of an external policy and the ONNX file that it names.
///
/// # Errors
/// A file cannot be read, the description is invalid, or the network does not fit it; the error says what was expected.
pub fn load(path: &Path) -> Result<Agent, AgentError> {
    from_bytes(path, &files::read_bounded(path, MAX_BYTES).map_err(FileError::of(POLICY, path))?)
}

/// Checks the description `text` before it is written to `path`, with its network if that exists. Returns true if it does.
///
/// # Errors
/// The description is invalid, or the network cannot be read or does not fit it; the error says what was expected.
pub fn check(path: &Path, text: &str) -> Result<bool, AgentError> {
    let spec = spec::Spec::parse(path, text)?;
    let has_network = folder_of(path).join(&spec.onnx).exists();
    if has_network {
        from_bytes(path, text.as_bytes())?;
    }
    Ok(has_network)
}

/// Parses the bytes of the YAML file at `path`, and reads the ONNX file that it names.
fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Agent, AgentError> {
    let text = std::str::from_utf8(bytes).map_err(|_| FileError::of(POLICY, path)("it is not text in UTF-8"))?;
    let spec = spec::Spec::parse(path, text)?;
    let (network, network_files) = onnx::OnnxNetwork::load(&folder_of(path).join(&spec.onnx))?;
    spec.check(&network, folder_of(path)).map_err(FileError::of(POLICY, path))?;
    let spec::Spec { layout, action, config, .. } = spec;
    let parts: Vec<&[u8]> = std::iter::once(bytes).chain(network_files.iter().map(Vec::as_slice)).collect();
    let period_s = config.simulation.policy_period_s();
    let inference = Inference { layout, action, network: Network::Onnx(network), period_s };
    Ok(Agent::external(inference, config, files::sha256(&parts)))
}

fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}

/*! External policies: an ONNX network, and a YAML file that says what it sees and what its outputs mean.

The YAML file is the policy: it names its ONNX file, and everything that takes a policy takes it. Two examples with every
key explained are `examples/policies/rsl_rl.yaml` and `examples/policies/playground.yaml`. An observation is a list of
[`Observed`](crate::observation::Observed) quantities as in a configuration; an action becomes joint targets for the PD law
with the gains, rates and latency that the policy was trained with.
*/

mod describe;
mod spec;

use std::path::Path;

pub use describe::{describe, describe_network, is_described_by_us};

use super::inference::{Inference, Network};
use super::{Agent, AgentError, onnx};
use crate::util::files::{self, FileError};

/// The name of the file's kind in errors.
const POLICY: &str = "policy";

/// Larger files are not descriptions of a policy.
const MAX_BYTES: u64 = 256 << 10;

/// Reads the YAML file of an external policy and the ONNX file that it names.
///
/// # Errors
/// [`AgentError`] that says what was found and what was expected.
pub fn load(path: &Path) -> Result<Agent, AgentError> {
    let bytes = files::read_bounded(path, MAX_BYTES).map_err(FileError::of(POLICY, path))?;
    let spec = spec::Spec::parse(path, &String::from_utf8_lossy(&bytes))?;
    let onnx = path.parent().unwrap_or(Path::new("")).join(&spec.onnx);
    let network_bytes = files::read_bounded(&onnx, onnx::MAX_BYTES).map_err(FileError::of(POLICY, &onnx))?;
    let network = onnx::Network::from_bytes(&network_bytes, &onnx)?;
    spec.check(&network).map_err(FileError::of(POLICY, path))?;
    let spec::Spec { layout, action, config, .. } = spec;
    let period_s = config.simulation.policy_period_s();
    let inference = Inference { layout, action, network: Network::Onnx(network), period_s };
    Ok(Agent::external(inference, config, files::sha256(&[&bytes, &network_bytes])))
}

/*! ONNX: [`export`] writes a policy of Supple for every other runtime, [`OnnxNetwork`] runs an external one.

Read `network`, then `operators`. The reader is an interpreter of the operators that policy networks of dense layers
use. A general runtime would be a hundred crates, or a shared library to install, for networks that take a few
microseconds. An operator that is not supported is named in the error.
*/

mod arithmetic;
mod export;
mod network;
mod operators;
#[allow(missing_docs)] // The schema's own names; each message is described.
mod proto;
mod tensor;
mod weights;
mod wire;

pub use export::export;
pub use network::{OnnxNetwork, OnnxScratch, metadata};

/// The reason why a network cannot be run: what a file, a tensor or an operator has, and what is supported. The errors of
/// [`OnnxNetwork::load`] show it.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Unsupported(String);

impl<T: Into<String>> From<T> for Unsupported {
    fn from(problem: T) -> Self {
        Unsupported(problem.into())
    }
}

type Result<T> = std::result::Result<T, Unsupported>;

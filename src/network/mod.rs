/*! Networks: their weights as plain numbers, and their evaluation.

Everything that has or trains a network reads and writes [`Mlp`]: learners, policy files, the contact network, ONNX.
[`PackedMlp`] evaluates one, with the same bits for a row alone and in a batch.
*/

pub(crate) mod kernels;
mod layers;
mod packed;
pub(crate) mod panel;

pub use layers::{ActorCritic, Layer, Mlp};
pub(crate) use packed::BLOCK;
pub use packed::{PackedMlp, Scratch};

/*! Networks: weights as plain numbers, and their evaluation.

Start with [`Mlp`] and [`ActorCritic`], the form in which learners, policy files, the contact network and ONNX exchange
weights. [`PackedMlp`] evaluates a network, with the same bits for a row alone and in a batch.
*/

pub(crate) mod kernels;
mod layers;
mod packed;
pub(crate) mod panel;

pub use layers::{ActorCritic, Layer, Mlp};
pub(crate) use layers::{NetworkError, forward};
pub(crate) use packed::BLOCK;
pub use packed::{PackedMlp, Scratch};

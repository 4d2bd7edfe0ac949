/*!
Proximal policy optimisation on the CPU.

[`mod@reference`] states what is computed, in candle; [`Learner`] computes the same several times faster with fused
products on all cores; [`PackedMlp`] evaluates one network during rollouts, with the same bits.

The semantics are those of Stable-Baselines3 (advantages normalised per minibatch, unclipped value loss, joint
gradient-norm clip, Adam) with the adaptive learning rate of Rudin et al. ("Learning to walk in minutes using
massively parallel deep reinforcement learning", CoRL 2021) ahead of every step.
*/

mod block;
pub mod gaussian;
mod kernels;
mod learner;
mod loss;
mod network;
mod optimizer;
mod packed;
mod panel;
pub mod reference;
mod team;
#[cfg(test)]
mod tests;
mod update;

pub use gaussian::{DiagonalGaussian, KlDivergence};
pub use learner::{Learner, LearnerState};
pub use loss::{Batch, Hyperparameters, Samples};
pub use network::{ActorCritic, Layer, Mlp, TensorError};
pub use packed::{PackedMlp, Scratch};
pub use update::{UpdateFault, UpdateStatistics};

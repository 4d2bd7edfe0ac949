/*! Proximal policy optimisation on the CPU.

Start reading in [`mod@candle`], which computes the update in the order of the textbook. A [`Learner`] makes an update
of a batch; there are two, and the key `ppo.learner` chooses between them:

- [`CandleLearner`] computes the textbook's formulas with automatic differentiation;
- [`FusedLearner`], the default, computes the same several times faster, with gradients written by hand and fused
  products on all cores. [`PackedMlp`](crate::network::PackedMlp) evaluates one network during rollouts, with the same
  bits.

To try a new loss, change [`candle::Loss::new`] and train with `ppo.learner: candle`. Its keys go into [`Ppo`](crate::config::Ppo) and into
the list of those that the learner uses; the other learner refuses them. To keep the loss, add it to the fused learner; the tests that
compare the two show when it is right.

The semantics are those of Stable-Baselines3 (advantages normalised per minibatch, unclipped value loss, joint
gradient-norm clip, Adam) with the adaptive learning rate of Rudin et al. ("Learning to walk in minutes using
massively parallel deep reinforcement learning", CoRL 2021) ahead of every step.
*/

pub mod candle;
pub mod fused;
pub mod gaussian;
mod learner;
mod loss;
#[cfg(test)]
mod tests;
mod update;

pub use candle::CandleLearner;
pub use fused::FusedLearner;
pub use gaussian::{DiagonalGaussian, KlDivergence};
pub use learner::{Learner, LearnerState, PrecisionError, Together, learner, resolved};
pub use loss::{Batch, Samples, weight_after};
pub use update::{UpdateFault, UpdateStatistics};

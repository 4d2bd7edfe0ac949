/*!
The learner that trains by default: the same numbers as [`candle`](super::candle), several times faster.

Start with [`FusedLearner`]'s three phases. A change of the loss is a change of `policy_loss` or `value_loss` in `block.rs`,
gradient included.
*/

mod block;
mod learner;
mod optimizer;
mod panel;
pub(in crate::ppo) mod team;

pub use learner::FusedLearner;

/*! The readable learner, for reading and for trying new losses: candle's networks, automatic differentiation, a
textbook loop.

[`Loss::new`] is the loss, [`CandleLearner`] the loop around it, [`CandleAdam`] its optimiser; any other `candle_nn::Optimizer` fits
too. `ppo.learner: candle` trains with it; the fused learner is tested against it.

Its bits do not depend on threads: candle's products distribute elements of their results, never the sum of an element.
They may depend on the processor.
*/

mod adam;
mod learner;
mod loss;
mod networks;

pub use adam::CandleAdam;
pub use learner::CandleLearner;
pub use loss::Loss;
pub(super) use loss::OPTIONAL_KEYS;
pub use networks::CandleNetworks;

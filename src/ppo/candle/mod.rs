/*!
The learner to read, and to try a new loss in: candle's networks, gradients by automatic differentiation, a textbook loop.

[`Loss::new`] is the loss, [`CandleLearner`] the loop around it, [`Adam`] its optimiser; any other `candle_nn::Optimizer` fits
too. `ppo.learner: candle` trains with it; the fused learner is tested against it.

Its bits do not depend on threads: candle's products share out elements of their results, never the sum behind one. They may
depend on the processor.
*/

mod adam;
mod learner;
mod loss;
mod networks;

pub use adam::Adam;
pub use learner::CandleLearner;
pub use loss::Loss;
pub use networks::Networks;

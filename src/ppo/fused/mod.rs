/*!
The learner that trains by default: the same numbers as [`candle`](super::candle), many times faster.

Start with [`FusedLearner`]'s three phases. What they compute with is an [`Arithmetic`], of which there are two: [`Panels`]
of f32 for every machine, and bf16 `Tiles` for those that have a unit for them. A change of the loss is a change of
`losses.rs`, gradient included.
*/

mod arithmetic;
mod learner;
mod losses;
mod optimizer;
mod panels;
pub(in crate::ppo) mod team;
#[cfg(tiles)]
mod tiles;
mod tree;

pub use arithmetic::{Arithmetic, Chunk};
pub use learner::FusedLearner;
pub use panels::Panels;
#[cfg(tiles)]
pub use tiles::{Tiles, available as tiles_available};

/// Returns true if this machine has tile units that this program can use.
#[cfg(not(tiles))]
pub fn tiles_available() -> bool {
    false
}

/*! The default learner: the same numbers as [`candle`](super::candle), many times faster.

Start with [`FusedLearner`]'s three phases. They compute with an [`Arithmetic`], of which there are two: [`Panels`]
of f32 for every machine, and bf16 `Tiles` for processors with tile units (AMX). To change the loss, change
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

pub use arithmetic::{Arithmetic, Chunk, LayerPanels};
pub use learner::FusedLearner;
pub(super) use losses::OPTIONAL_KEYS;
pub use panels::Panels;
#[cfg(tiles)]
pub use tiles::{Tiles, available as tiles_available};

/// Returns true if this machine has tile units that this program can use.
#[cfg(not(tiles))]
pub fn tiles_available() -> bool {
    false
}

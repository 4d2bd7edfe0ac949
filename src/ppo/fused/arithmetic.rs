//! The interface of the arithmetics: what the three phases of an update compute with.

use std::fmt::Debug;
use std::ops::Range;
use std::sync::RwLockReadGuard;

use super::losses::Pass;
use super::optimizer::{AdamParameters, AdamStep};
use super::team::Member;
use crate::network::ActorCritic;
use crate::network::kernels::AlignedBuffer;
use crate::ppo::loss::Minibatch;

/// Consecutive blocks of a minibatch that go through phases 1 and 2 together: few enough to stay in the caches in
/// between.
#[derive(Debug, Clone, Copy)]
pub struct Chunk {
    /// Index of the first block.
    pub start: usize,
    /// Number of blocks in the chunk.
    pub blocks: usize,
    /// Number of rows of a block; the last of a shard may have fewer.
    pub rows: usize,
    /// True if the chunk completes the gradient: the minibatch ends, and no other rank adds to it.
    pub completes: bool,
    /// Number of blocks in each shard.
    pub shard_blocks: usize,
    /// Number of the minibatch's shards on this rank.
    pub shards: usize,
}

/// A layer's panels, locked for reading.
pub type LayerPanels<'a, 'b, P> = &'a [RwLockReadGuard<'b, P>];

/// The blocks of a chunk that belong to one shard.
#[derive(Debug, Clone)]
pub struct ShardBlocks {
    /// Range of blocks, counted from the start of the chunk.
    pub blocks: Range<usize>,
    /// Index of the shard, counted from zero.
    pub shard: usize,
    /// True if this is the first block of its shard.
    pub is_first: bool,
    /// True if this is the last block of its shard.
    pub is_last: bool,
}

impl Chunk {
    /// Splits the blocks of the chunk by shard.
    pub fn pieces(self) -> impl Iterator<Item = ShardBlocks> {
        let (first, end) = (self.start, self.start + self.blocks);
        (first / self.shard_blocks..end.div_ceil(self.shard_blocks)).map(move |shard| {
            let of_shard = shard * self.shard_blocks..(shard + 1) * self.shard_blocks;
            let (from, to) = (first.max(of_shard.start), end.min(of_shard.end));
            let blocks = from - first..to - first;
            ShardBlocks { blocks, shard, is_first: from == of_shard.start, is_last: to == of_shard.end }
        })
    }
}

/// Both networks, their gradients and Adam's moments in one arithmetic. All threads of a team call every phase.
pub trait Arithmetic: Debug + Send + Sync + Sized {
    /// Largest number of rows that go through a network together.
    const BLOCK: usize;

    /// Smallest number of rows that go through a network together where threads lack work; losses are summed over as many. A power
    /// of two of them make a block.
    const LEAST_BLOCK: usize;

    /// Number of rows of a chunk for each two threads: as many as fit into the caches together with the weights.
    const CHUNK: usize;

    /// Divergences below this count as zero, as rounding errors.
    const KL_ROUNDING: f64;

    /// Scratch memory of one thread during an update.
    type Workspace;

    /// Builds the networks from parameters and their first and second moments, with room for `blocks` blocks of rows.
    fn new(parts: [&ActorCritic; 3], blocks: usize) -> Self;

    /// Creates the scratch memory of a thread, on that thread.
    fn workspace(&self) -> Self::Workspace;

    /// Phase 1: forward pass, loss and backward pass of both networks, block by block.
    fn passes(
        &self,
        team: Member<'_>,
        workspace: &mut Self::Workspace,
        minibatch: &Minibatch<'_>,
        chunk: Chunk,
        loss: impl Fn(Pass<'_>),
    );

    /// Phase 2: the gradient of all weights, added to that of the chunks before, in order within shards and over the
    /// tree of shards; after the last chunk `conclude` gets its sum of squares, on one thread.
    fn gradients(&self, team: Member<'_>, workspace: &mut Self::Workspace, chunk: Chunk, conclude: impl FnOnce(f64));

    /// Returns the number of weight panels, each of which has its own gradient.
    fn panels(&self) -> usize;

    /// Reads or replaces the gradient of a panel, and returns its sum of squares.
    fn gradient(&self, panel: usize, with: impl FnOnce(&mut AlignedBuffer)) -> f64;

    /// Phase 3: a step of Adam for all weights.
    fn steps(&self, team: Member<'_>, workspace: &mut Self::Workspace, step: &AdamStep);

    /// Copies one part (values, gradients or moments) of all weights and biases into `networks`, as plain numbers.
    fn unpack(&self, part: fn(&AdamParameters) -> &AlignedBuffer, networks: &mut ActorCritic);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_are_cut_where_shards_end() {
        let pieces = |start, blocks| {
            let chunk = Chunk { start, blocks, rows: 64, completes: false, shard_blocks: 3, shards: 4 };
            chunk.pieces().map(|piece| (piece.blocks, piece.shard, piece.is_first, piece.is_last)).collect::<Vec<_>>()
        };
        assert_eq!(pieces(0, 4), [(0..3, 0, true, true), (3..4, 1, true, false)]);
        assert_eq!(pieces(4, 4), [(0..2, 1, false, true), (2..4, 2, true, false)]);
        assert_eq!(pieces(4, 1), [(0..1, 1, false, false)]);
    }
}

/*!
What the three phases of an update compute with.
*/

use std::fmt::Debug;

use super::losses::Pass;
use super::optimizer::{AdamStep, Parameters};
use super::team::Member;
use crate::network::ActorCritic;
use crate::network::kernels::Buffer;
use crate::ppo::loss::Minibatch;

/// Blocks of a minibatch that go through phases 1 and 2 together: few enough to stay in the caches in between.
#[derive(Debug, Clone, Copy)]
pub struct Chunk {
    /// First block.
    pub start: usize,
    /// Number of blocks.
    pub blocks: usize,
    /// Whether the minibatch ends with it.
    pub is_last: bool,
}

/// Both networks, their gradients and Adam's moments in one arithmetic. Every phase is called by all threads of a team.
pub trait Arithmetic: Debug + Send + Sync + Sized {
    /// Rows that go through a network together.
    const BLOCK: usize;

    /// Divergences below this are rounding errors.
    const KL_ROUNDING: f64;

    /// What a thread needs for itself while an update lasts.
    type Workspace;

    /// From parameters and their first and second moments, with room for so many blocks of rows.
    fn new(parts: [&ActorCritic; 3], blocks: usize) -> Self;

    /// One for each thread, made on that thread.
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

    /// Phase 2: the gradient of all weights, added to that of the chunks before; after the last chunk its sum of squares
    /// goes to `conclude`, on one thread.
    fn gradients(&self, team: Member<'_>, workspace: &mut Self::Workspace, chunk: Chunk, conclude: impl FnOnce(f64));

    /// Phase 3: a step of all weights.
    fn steps(&self, team: Member<'_>, workspace: &mut Self::Workspace, step: &AdamStep);

    /// Writes a part of all weights and biases into `networks`, as plain numbers.
    fn unpack(&self, part: fn(&Parameters) -> &Buffer, networks: &mut ActorCritic);
}

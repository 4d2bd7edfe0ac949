/*! The fused learner: one PPO update on all cores.

Each minibatch goes through three phases, each a list of independent tasks:

1. forward pass, loss and backward pass of one network over one block of rows;
2. gradient of one panel of weights, summed over the rows of each shard in order, and over the tree of [shards](crate::ranks);
3. Adam for one panel.

Phases 1 and 2 are repeated for each [`Chunk`] of the minibatch, so that the results of phase 1 are still in the
caches in phase 2.

Each list has the policy's tasks first and then the value function's, so that threads keep to one network and find their
data in their own caches (see [`Team`]). Parameters have the same bits for any number of threads.
*/

use std::sync::{Arc, Mutex, PoisonError, RwLock};

use pulp::Arch;

use super::losses::{Pass, Sums};
use super::optimizer::{Adam, AdamParameters, AdamStep};
use super::team::{Member, Team, lock, read, write};
use super::{Arithmetic, Chunk};
use crate::config::{LOG_STD_RANGE, Ppo};
use crate::network::ActorCritic;
use crate::network::kernels::{AlignedBuffer, SumOfSquares};
use crate::ppo::learner::Together;
use crate::ppo::loss::Minibatch;
use crate::ppo::update::{UpdateProgress, check};
use crate::ppo::{Batch, DiagonalGaussian, KlDivergence, Learner, LearnerState, UpdateFault, UpdateStatistics};
use crate::ranks::{Ranks, tree_sum};

/// Number of sums in [`FusedLearner::totals`] before those of `ln σ`.
const LOSSES: usize = 4;

/// Sums over all ranks, exchanged for each minibatch.
#[derive(Debug, Default)]
struct Exchanged {
    /// Gradients of all panels, one after the other.
    gradient: Vec<f32>,
    /// Sums of the losses and the gradient of `ln σ`, see [`FusedLearner::totals`].
    totals: Vec<f64>,
    /// Sum of squares of each panel's gradient.
    squares: Vec<f64>,
}

/// The fast learner: trains an [`ActorCritic`] by PPO with fused kernels on all cores.
#[derive(Debug)]
pub struct FusedLearner<A> {
    settings: Ppo,
    threads: usize,
    ranks: Arc<dyn Ranks>,
    pub(in crate::ppo) arithmetic: A,
    log_std: RwLock<AdamParameters>,
    /// Number of rows of a block.
    block: usize,
    /// Number of blocks in a chunk.
    chunk_blocks: usize,
    /// Losses of each [`Arithmetic::LEAST_BLOCK`] rows, of the policy and of the value function.
    sums: [Vec<Mutex<Sums>>; 2],
    exchanged: Mutex<Exchanged>,
    steps: u64,
    learning_rate: f64,
    together: Together,
    /// Networks of zeros, which provide the shapes.
    shapes: ActorCritic,
}

impl<A: Arithmetic> FusedLearner<A> {
    /// Creates a learner that continues from `state` on `threads` threads, whose number changes only the speed.
    pub fn new(state: &LearnerState, settings: Ppo, threads: usize, ranks: Arc<dyn Ranks>) -> Self {
        assert!(settings.minibatch_size > 0, "a minibatch needs samples");
        let parts = [&state.parameters, &state.first_moment, &state.second_moment];
        let threads = threads.max(1);
        let shards = settings.shards / ranks.count();
        let blocks = |size: usize| shards * (settings.minibatch_size / settings.shards).div_ceil(size);
        // Every thread has one, of one of the two networks.
        let mut block = A::BLOCK;
        while block > A::LEAST_BLOCK && 2 * blocks(block) < threads {
            block /= 2;
        }
        let chunk_blocks = (A::CHUNK * threads.div_ceil(2) / block).min(blocks(block));
        let sums = blocks(A::LEAST_BLOCK);
        Self {
            arithmetic: A::new(parts, chunk_blocks),
            block,
            chunk_blocks,
            log_std: RwLock::new(AdamParameters::new(parts.map(|part| AlignedBuffer::from(&*part.log_std)))),
            sums: std::array::from_fn(|_| (0..sums).map(|_| Mutex::default()).collect()),
            exchanged: Mutex::default(),
            threads,
            ranks,
            steps: state.steps,
            learning_rate: state.learning_rate,
            together: Together::default(),
            shapes: state.parameters.zeros_like(),
            settings,
        }
    }

    pub(in crate::ppo) fn unpacked(&self, part: fn(&AdamParameters) -> &AlignedBuffer) -> ActorCritic {
        let mut unpacked = self.shapes.clone();
        unpacked.log_std.copy_from_slice(part(&read(&self.log_std)));
        self.arithmetic.unpack(part, &mut unpacked);
        unpacked
    }

    /// Runs phases 1 and 2, then `conclude` on one thread.
    pub(in crate::ppo) fn differentiate(
        &self,
        team: Member<'_>,
        workspace: &mut A::Workspace,
        minibatch: &Minibatch<'_>,
        conclude: impl FnOnce(UpdateStatistics),
    ) {
        let new = DiagonalGaussian::new(&read(&self.log_std).values);
        let kl = KlDivergence::new(&DiagonalGaussian::new(minibatch.batch.log_std), &new);
        let (shards, shard_blocks) = (minibatch.shards, minibatch.shard_blocks(self.block));
        let loss = |pass: Pass<'_>| {
            let (network, block) = (pass.network, pass.block);
            let rows = minibatch.block(self.block, block).chunks(A::LEAST_BLOCK);
            let of_shard = minibatch.shard_blocks(A::LEAST_BLOCK);
            let first = block / shard_blocks * of_shard + block % shard_blocks * (self.block / A::LEAST_BLOCK);
            for ((sums, pass), rows) in self.sums[network][first..].iter().zip(pass.parts(A::LEAST_BLOCK)).zip(rows) {
                *lock(sums) = if network == 0 {
                    pass.policy_loss(minibatch, rows, &new, &kl)
                } else {
                    pass.value_loss(minibatch, rows)
                };
            }
        };
        let blocks = shards * shard_blocks;
        let (mut conclude, are_several) = (Some(conclude), self.ranks.count() > 1);
        for start in (0..blocks).step_by(self.chunk_blocks) {
            let end = blocks.min(start + self.chunk_blocks);
            let completes = end == blocks && !are_several;
            let chunk = Chunk { start, blocks: end - start, rows: self.block, completes, shard_blocks, shards };
            self.arithmetic.passes(team, workspace, minibatch, chunk, loss);
            self.arithmetic.gradients(team, workspace, chunk, |squares| {
                if let Some(conclude) = conclude.take_if(|_| completes) {
                    conclude(self.summary(minibatch, &self.totals(minibatch), squares));
                }
            });
        }
        if let Some(conclude) = conclude.filter(|_| are_several) {
            self.exchange(team, minibatch, conclude);
        }
    }

    /// Sums gradients and losses over all ranks.
    fn exchange(&self, team: Member<'_>, minibatch: &Minibatch<'_>, conclude: impl FnOnce(UpdateStatistics)) {
        let arithmetic = &self.arithmetic;
        let sum = || {
            let Exchanged { gradient, totals, squares } = &mut *lock(&self.exchanged);
            gradient.clear();
            for panel in 0..arithmetic.panels() {
                arithmetic.gradient(panel, |own| gradient.extend_from_slice(own));
            }
            *totals = self.totals(minibatch);
            self.ranks.sum(gradient, totals);
            let mut rest = &gradient[..];
            squares.clear();
            squares.extend((0..arithmetic.panels()).map(|panel| {
                arithmetic.gradient(panel, |own| {
                    let (summed, others) = rest.split_at(own.len());
                    own.copy_from_slice(summed);
                    rest = others;
                })
            }));
            conclude(self.summary(minibatch, totals, squares.iter().sum()));
        };
        team.phase(0, |_| (), sum);
    }

    /// Sums over this rank's shards, in the order of their tree: policy loss, divergence, clipped samples, value loss
    /// and the gradient of the policy loss by `ln σ`.
    fn totals(&self, minibatch: &Minibatch<'_>) -> Vec<f64> {
        let shard_blocks = minibatch.shard_blocks(A::LEAST_BLOCK);
        let sum = |network: usize, part: &dyn Fn(&Sums) -> f64| {
            let of_shard = |shard: usize| &self.sums[network][shard * shard_blocks..][..shard_blocks];
            tree_sum(minibatch.shards, |shard| of_shard(shard).iter().map(|sums| part(&lock(sums))).sum())
        };
        let losses = [sum(0, &|s| s.policy_loss), sum(0, &|s| s.kl), sum(0, &|s| s.clipped), sum(1, &|s| s.value_loss)];
        let log_std = (0..minibatch.batch.log_std.len()).map(|i| sum(0, &|sums| sums.log_std_gradient[i]));
        losses.into_iter().chain(log_std).collect()
    }

    /// Computes the gradient of `ln σ`, the losses and the gradient norm from the sums over all ranks and weights.
    fn summary(&self, minibatch: &Minibatch<'_>, totals: &[f64], squares: f64) -> UpdateStatistics {
        let mean = |index: usize| totals[index] / minibatch.samples as f64;
        let mut log_std = write(&self.log_std);
        for (gradient, sum) in log_std.gradient.iter_mut().zip(&totals[LOSSES..]) {
            *gradient = (sum - minibatch.settings.entropy_coefficient) as f32;
        }
        let blocks = minibatch.shards * minibatch.shard_blocks(A::LEAST_BLOCK);
        let gradient_norm = (squares + Arch::new().dispatch(SumOfSquares(&log_std.gradient))).sqrt();
        let kl = mean(1);
        UpdateStatistics {
            policy_loss: mean(0),
            value_loss: mean(3),
            entropy: DiagonalGaussian::new(&log_std.values).entropy(),
            kl: if kl.abs() < A::KL_ROUNDING { 0.0 } else { kl },
            clip_fraction: mean(2),
            max_ratio: self.sums[0][..blocks].iter().map(|sums| lock(sums).max_ratio).fold(0.0, f64::max),
            gradient_norm,
            max_gradient_norm: gradient_norm,
            learning_rate: 0.0,
        }
    }

    /// Runs phase 3 for `ln σ`.
    fn step_log_std(&self, step: &AdamStep) {
        let mut log_std = write(&self.log_std);
        Arch::new().dispatch(Adam { parameters: &mut log_std, step });
        let [low, high] = LOG_STD_RANGE;
        log_std.values.iter_mut().for_each(|value| *value = value.clamp(low, high));
    }
}

impl<A: Arithmetic> Learner for FusedLearner<A> {
    fn set_entropy_coefficient(&mut self, weight: f64) {
        self.settings.entropy_coefficient = weight;
    }

    fn update(&mut self, batch: &Batch<'_>, permutations: &[Vec<u32>]) -> Result<UpdateStatistics, UpdateFault> {
        check(batch, permutations, &self.shapes, &self.settings, &*self.ranks)?;
        let minibatches = Minibatch::all(batch, &self.settings, permutations, &*self.ranks);
        let progress = Mutex::new(UpdateProgress::new(self.steps, self.learning_rate, minibatches.len()));
        let together = Team::run(self.threads, |team| {
            let workspace = &mut self.arithmetic.workspace();
            for minibatch in &minibatches {
                self.differentiate(team, workspace, minibatch, |summary| {
                    let mut progress = lock(&progress);
                    progress.conclude(minibatch, summary);
                    if let Some(step) = progress.step {
                        self.step_log_std(&AdamStep::new(&self.settings, &step));
                    }
                });
                let Some(step) = lock(&progress).step else { return };
                self.arithmetic.steps(team, workspace, &AdamStep::new(&self.settings, &step));
            }
        });

        let progress = progress.into_inner().unwrap_or_else(PoisonError::into_inner);
        self.steps = progress.steps;
        self.learning_rate = progress.learning_rate;
        self.together = together;
        let mut statistics = progress.statistics;
        // The largest over all ranks; the rest are sums over them already.
        for other in self.ranks.gather(statistics.max_ratio.to_le_bytes().to_vec()) {
            let other = other.first_chunk().map_or(0.0, |bytes| f64::from_le_bytes(*bytes));
            statistics.max_ratio = statistics.max_ratio.max(other);
        }
        progress.fault.map_or(Ok(statistics), Err)
    }

    fn state(&self) -> LearnerState {
        LearnerState {
            parameters: self.parameters(),
            first_moment: self.unpacked(|parameters| &parameters.first_moment),
            second_moment: self.unpacked(|parameters| &parameters.second_moment),
            steps: self.steps,
            learning_rate: self.learning_rate,
        }
    }

    fn parameters(&self) -> ActorCritic {
        self.unpacked(|parameters| &parameters.values)
    }

    fn together(&self) -> Together {
        self.together
    }
}

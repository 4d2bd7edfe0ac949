/*!
The fused learner: one PPO update on all cores.

Each minibatch goes through three phases, each a list of independent tasks:

1. forward and backward pass of one network over one block of rows ([`Block`]);
2. gradient of one weight panel, summed over all rows in order;
3. Adam for one panel.

Each list has the policy's tasks first and then the value function's, so that threads keep to one network and find what
they need in their own caches (see [`Team`]). Blocks and panels sit in read-write locks: a phase writes the one kind and
reads the other. No gradient is ever summed across threads, and sums of partial results run in a fixed order, so the
parameters have the same bits for any number of threads.
*/

use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use pulp::Arch;

use super::block::{Block, Panels, Sums};
use super::optimizer::{Adam, AdamStep, Parameters};
use super::panel::Panel;
use super::team::{Member, Team};
use crate::config::LOG_STD_RANGE;
use crate::network::ActorCritic;
use crate::network::BLOCK;
use crate::network::kernels::{Buffer, ColumnSums, Ends, Product, Stretch, SumOfSquares, padded, row_stride};
use crate::network::panel::{panel_starts, unpack};
use crate::ppo::loss::Minibatch;
use crate::ppo::update::{Progress, check};
use crate::ppo::{
    Batch, DiagonalGaussian, Hyperparameters, KlDivergence, Learner, LearnerState, UpdateFault, UpdateStatistics,
};

/// Trains an [`ActorCritic`] by PPO, as fast as we know how.
#[derive(Debug)]
pub struct FusedLearner {
    settings: Hyperparameters,
    threads: usize,
    pub(in crate::ppo) arch: Arch,
    /// Of both networks, layer by layer.
    panels: Vec<RwLock<Panel>>,
    log_std: RwLock<Parameters>,
    /// Of the policy and of the value function.
    blocks: [Vec<RwLock<Block>>; 2],
    steps: u64,
    learning_rate: f64,
    /// Zeros, for their shapes.
    shapes: ActorCritic,
}

impl FusedLearner {
    /// Continues from `state` on `threads` threads. The number of threads changes the speed only.
    ///
    /// # Panics
    /// When the minibatch size is zero, or the moments do not have the shapes of the parameters.
    pub fn new(state: &LearnerState, settings: Hyperparameters, threads: usize) -> Self {
        assert!(settings.minibatch_size > 0, "a minibatch needs samples");
        let parts = [&state.parameters, &state.first_moment, &state.second_moment];
        let mut panels = Vec::new();
        for (network, mlps) in [parts.map(|part| &part.policy), parts.map(|part| &part.value)].into_iter().enumerate() {
            for (depth, layer) in mlps[0].layers.iter().enumerate() {
                let layers = mlps.map(|mlp| &mlp.layers[depth]);
                let panel = |first| RwLock::new(Panel::new(network, depth, first, layers));
                panels.extend(panel_starts(layer.outputs()).map(panel));
            }
        }
        let blocks = [&state.parameters.policy, &state.parameters.value].map(|mlp| {
            let count = settings.minibatch_size.div_ceil(BLOCK);
            (0..count).map(|_| RwLock::new(Block::new(mlp))).collect()
        });
        Self {
            panels,
            log_std: RwLock::new(Parameters::new(parts.map(|part| Buffer::from(&*part.log_std)))),
            blocks,
            arch: Arch::new(),
            threads: threads.max(1),
            steps: state.steps,
            learning_rate: state.learning_rate,
            shapes: state.parameters.zeros_like(),
            settings,
        }
    }

    pub(in crate::ppo) fn unpacked(&self, part: fn(&Parameters) -> &Buffer) -> ActorCritic {
        let mut unpacked = self.shapes.clone();
        unpacked.log_std.copy_from_slice(part(&read(&self.log_std)));
        for panel in self.panels.iter().map(read) {
            let mlp = if panel.network == 0 { &mut unpacked.policy } else { &mut unpacked.value };
            unpack(part(&panel.parameters), panel.first, &mut mlp.layers[panel.depth]);
        }
        unpacked
    }

    /// Phase 1: forward and backward pass of both networks, block by block.
    pub(in crate::ppo) fn passes(&self, team: Member<'_>, minibatch: &Minibatch<'_>) {
        let panels: Vec<_> = self.panels.iter().map(read).collect();
        let layers: Vec<_> = panels.chunk_by(|a, b| (a.network, a.depth) == (b.network, b.depth)).collect();
        let (policy, value) = layers.split_at(self.shapes.policy.layers.len());
        let networks: [&[Panels<'_, '_>]; 2] = [policy, value];
        let new = DiagonalGaussian::new(&read(&self.log_std).values);
        let kl = KlDivergence::new(&DiagonalGaussian::new(minibatch.batch.log_std), &new);

        let blocks = minibatch.rows.chunks(BLOCK).len();
        let task = |task: usize| {
            let (network, i) = (task / blocks, task % blocks);
            let rows = &minibatch.rows[i * BLOCK..minibatch.rows.len().min((i + 1) * BLOCK)];
            let mut block = write(&self.blocks[network][i]);
            block.forward(self.arch, networks[network], minibatch.batch.observations, rows);
            if network == 0 {
                block.policy_loss(minibatch, rows, &new, &kl);
            } else {
                block.value_loss(minibatch, rows);
            }
            block.backward(self.arch, networks[network]);
        };
        team.phase(2 * blocks, task, || ());
    }

    /// Phase 2: gradients of all panels from the deltas of all blocks.
    pub(in crate::ppo) fn gradients(
        &self,
        team: Member<'_>,
        minibatch: &Minibatch<'_>,
        conclude: impl FnOnce(UpdateStatistics),
    ) {
        let count = minibatch.rows.chunks(BLOCK).len();
        let task = |task: usize| {
            let panel = &mut *write(&self.panels[task]);
            let blocks: Vec<_> = self.blocks[panel.network][..count].iter().map(read).collect();
            let stretches: Vec<_> = blocks
                .iter()
                .map(|block| Stretch {
                    depth: block.rows,
                    a: &block.activations[panel.depth],
                    b: &block.deltas[panel.depth][panel.first..],
                })
                .collect();
            let width = padded(panel.outputs());
            let delta_stride = row_stride(panel.layer_outputs);
            let (weights, bias) = panel.parameters.gradient.split_at_mut(panel.inputs * width);
            let product = Product {
                rows: panel.inputs,
                columns: width,
                stretches: &stretches,
                a_transposed: true,
                a_stride: row_stride(panel.inputs),
                b_stride: delta_stride,
                ends: Ends::Zero,
                c: weights,
                c_stride: width,
            };
            product.compute(self.arch);
            self.arch.dispatch(ColumnSums { stretches: &stretches, b_stride: delta_stride, sums: bias });
            panel.squares = self.arch.dispatch(SumOfSquares(&panel.parameters.gradient));
        };
        team.phase(self.panels.len(), task, || conclude(self.summary(minibatch)));
    }

    /// After phase 2, on one thread: the gradient of `ln σ`, the losses and the gradient norm.
    fn summary(&self, minibatch: &Minibatch<'_>) -> UpdateStatistics {
        let count = minibatch.rows.chunks(BLOCK).len();
        let [policy, value] = self.blocks.each_ref().map(|blocks| blocks[..count].iter().map(read).collect::<Vec<_>>());
        let mean = |blocks: &[RwLockReadGuard<'_, Block>], part: fn(&Sums) -> f64| {
            blocks.iter().map(|block| part(&block.sums)).sum::<f64>() / minibatch.rows.len() as f64
        };
        let mut log_std = write(&self.log_std);
        for (i, gradient) in log_std.gradient.iter_mut().enumerate() {
            let sum: f64 = policy.iter().map(|block| block.sums.log_std_gradient[i]).sum();
            *gradient = (sum - minibatch.settings.entropy_coefficient) as f32;
        }
        let squares: f64 = self.panels.iter().map(|panel| read(panel).squares).sum();
        let gradient_norm = (squares + self.arch.dispatch(SumOfSquares(&log_std.gradient))).sqrt();
        UpdateStatistics {
            policy_loss: mean(&policy, |sums| sums.policy_loss),
            value_loss: mean(&value, |sums| sums.value_loss),
            entropy: DiagonalGaussian::new(&log_std.values).entropy(),
            kl: mean(&policy, |sums| sums.kl),
            clip_fraction: mean(&policy, |sums| sums.clipped),
            max_ratio: policy.iter().map(|block| block.sums.max_ratio).fold(0.0, f64::max),
            gradient_norm,
            max_gradient_norm: gradient_norm,
            learning_rate: 0.0,
        }
    }

    /// Phase 3: Adam.
    fn steps(&self, team: Member<'_>, step: &AdamStep) {
        let task = |task: usize| match self.panels.get(task) {
            Some(panel) => {
                let mut panel = write(panel);
                self.arch.dispatch(Adam { parameters: &mut panel.parameters, step });
                panel.transpose();
            }
            None => {
                let mut log_std = write(&self.log_std);
                self.arch.dispatch(Adam { parameters: &mut log_std, step });
                let [low, high] = LOG_STD_RANGE;
                log_std.values.iter_mut().for_each(|value| *value = value.clamp(low, high));
            }
        };
        team.phase(self.panels.len() + 1, task, || ());
    }
}

impl Learner for FusedLearner {
    fn update(&mut self, batch: &Batch<'_>, permutations: &[Vec<u32>]) -> Result<UpdateStatistics, UpdateFault> {
        check(batch, permutations, self.shapes.policy.inputs(), self.shapes.policy.outputs())?;
        let progress = Mutex::new(Progress::new(self.steps, self.learning_rate, &self.settings, permutations));
        Team::run(self.threads, |team| {
            for minibatch in Minibatch::all(batch, &self.settings, permutations) {
                self.passes(team, &minibatch);
                self.gradients(team, &minibatch, |summary| lock(&progress).conclude(&minibatch, summary));
                let Some(step) = lock(&progress).step else { return };
                self.steps(team, &AdamStep::new(&self.settings, &step));
            }
        });

        let progress = progress.into_inner().unwrap_or_else(PoisonError::into_inner);
        self.steps = progress.steps;
        self.learning_rate = progress.learning_rate;
        progress.fault.map_or(Ok(progress.statistics), Err)
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
}

// A lock is never used after its writer has panicked: the panic ends the whole team.

fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

fn lock<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

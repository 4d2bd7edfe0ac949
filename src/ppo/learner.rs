/*!
The fused learner: one PPO update on all cores.

Each minibatch goes through three phases, each a list of independent tasks:

1. forward and backward pass of one network over one block of rows ([`Block`]);
2. gradient of one weight panel, summed over all rows in order;
3. Adam for one panel.

Blocks and panels sit in read-write locks: a phase writes the one kind and reads the other. No gradient is ever summed
across threads, and sums of partial results run in a fixed order, so the parameters have the same bits for any number
of threads.
*/

use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use pulp::Arch;

use super::block::{Block, LayerView, Minibatch, Panel};
use super::kernels::{Buffer, Gradient, PANEL, Stretch, SumOfSquares, padded, row_stride};
use super::loss::advantage_normaliser;
use super::optimizer::{Adam, AdamStep, Parameters};
use super::packed::{BLOCK, pack, panel_count, panel_outputs, unpack};
use super::team::Team;
use super::{ActorCritic, Batch, DiagonalGaussian, Hyperparameters, KlDivergence, Layer, Mlp};

/// Everything that an update depends on besides its batch; what a checkpoint has to keep.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnerState {
    /// Policy and value function.
    pub parameters: ActorCritic,
    /// Adam's first moments, one for each parameter.
    pub first_moment: ActorCritic,
    /// Adam's second moments, one for each parameter.
    pub second_moment: ActorCritic,
    /// Gradient steps taken.
    pub steps: u64,
    /// Learning rate of the last step.
    pub learning_rate: f64,
}

impl LearnerState {
    /// Before the first update.
    pub fn new(parameters: ActorCritic, settings: &Hyperparameters) -> Self {
        let (first_moment, second_moment) = (parameters.zeros_like(), parameters.zeros_like());
        Self {
            parameters,
            first_moment,
            second_moment,
            steps: 0,
            learning_rate: settings.learning_rate,
        }
    }
}

/// What an update did; means over its minibatches unless said otherwise.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct UpdateStatistics {
    /// Clipped surrogate, negated.
    pub policy_loss: f64,
    /// Mean squared error of the values.
    pub value_loss: f64,
    /// Entropy of the policy.
    pub entropy: f64,
    /// Divergence from the policy of the rollout.
    pub kl: f64,
    /// Fraction of samples with a probability ratio outside the clip range.
    pub clip_fraction: f64,
    /// Joint norm before clipping.
    pub gradient_norm: f64,
    /// Largest joint norm before clipping.
    pub max_gradient_norm: f64,
    /// Of the last minibatch.
    pub learning_rate: f64,
}

/// Why an update stopped. The parameters are those before the step in question.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UpdateFault {
    /// A slice of the batch does not fit the others.
    #[error("{name} of the batch should have {expected} elements, but has {actual}")]
    Shape {
        /// The slice.
        name: &'static str,
        /// Length that fits.
        expected: usize,
        /// Length given.
        actual: usize,
    },
    /// A permutation names a sample that is not in the batch.
    #[error("the permutation of epoch {epoch} names sample {sample} of only {samples}")]
    Sample {
        /// Counted from zero.
        epoch: usize,
        /// Index given.
        sample: u32,
        /// Number of samples.
        samples: usize,
    },
    /// The loss, the divergence or the gradient is infinite or not a number.
    #[error(
        "minibatch {minibatch} of epoch {epoch} is not finite: policy loss {policy_loss}, value loss {value_loss}, \
         KL {kl}, gradient norm {gradient_norm}"
    )]
    NotFinite {
        /// Counted from zero.
        epoch: usize,
        /// Within the epoch, counted from zero.
        minibatch: usize,
        /// Samples of the minibatch.
        samples: Vec<u32>,
        /// Clipped surrogate, negated.
        policy_loss: f64,
        /// Mean squared error of the values.
        value_loss: f64,
        /// Divergence from the policy of the rollout.
        kl: f64,
        /// Joint norm of the gradient.
        gradient_norm: f64,
    },
}

/// Trains an [`ActorCritic`] by PPO.
#[derive(Debug)]
pub struct Learner {
    settings: Hyperparameters,
    threads: usize,
    arch: Arch,
    networks: [Network; 2],
    log_std: RwLock<Parameters>,
    steps: u64,
    learning_rate: f64,
}

/// Policy or value function.
#[derive(Debug)]
struct Network {
    layers: Vec<PanelledLayer>,
    blocks: Vec<RwLock<Block>>,
}

#[derive(Debug)]
struct PanelledLayer {
    inputs: usize,
    outputs: usize,
    panels: Vec<RwLock<Panel>>,
}

impl Learner {
    /// Continues from `state` on `threads` threads. The number of threads changes the speed only.
    pub fn new(state: &LearnerState, settings: Hyperparameters, threads: usize) -> Self {
        let LearnerState {
            parameters,
            first_moment,
            second_moment,
            ..
        } = state;
        let blocks = settings.minibatch_size.div_ceil(BLOCK);
        let network = |mlp: fn(&ActorCritic) -> &Mlp| {
            let [values, first, second] = [parameters, first_moment, second_moment].map(mlp);
            let layers = values.layers.iter().zip(&first.layers).zip(&second.layers).enumerate();
            Network {
                layers: layers
                    .map(|(i, ((values, first), second))| PanelledLayer::new(i, values, first, second))
                    .collect(),
                blocks: (0..blocks).map(|_| RwLock::new(Block::new(values))).collect(),
            }
        };
        let mut log_std = Parameters::zeros(parameters.log_std.len());
        log_std.values.copy_from_slice(&parameters.log_std);
        log_std.first_moment.copy_from_slice(&first_moment.log_std);
        log_std.second_moment.copy_from_slice(&second_moment.log_std);
        Self {
            networks: [network(|x| &x.policy), network(|x| &x.value)],
            log_std: RwLock::new(log_std),
            arch: Arch::new(),
            steps: state.steps,
            learning_rate: state.learning_rate,
            threads: threads.max(1),
            settings,
        }
    }

    /// A copy of everything needed to continue with the same bits.
    pub fn state(&self) -> LearnerState {
        LearnerState {
            parameters: self.parameters(),
            first_moment: self.unpacked(|parameters| &parameters.first_moment),
            second_moment: self.unpacked(|parameters| &parameters.second_moment),
            steps: self.steps,
            learning_rate: self.learning_rate,
        }
    }

    /// A copy of the networks.
    pub fn parameters(&self) -> ActorCritic {
        self.unpacked(|parameters| &parameters.values)
    }

    pub(super) fn unpacked(&self, part: fn(&Parameters) -> &Buffer) -> ActorCritic {
        let [policy, value] = self.networks.each_ref().map(|network| Mlp {
            layers: network.layers.iter().map(|layer| layer.unpacked(part)).collect(),
        });
        ActorCritic {
            policy,
            value,
            log_std: part(&read(&self.log_std)).to_vec(),
        }
    }

    /// One PPO update: for each of `permutations` one epoch over the batch in that order, a gradient step for each
    /// `minibatch_size` samples (and one for what remains).
    ///
    /// # Errors
    /// When the batch or a permutation does not fit, or the loss or its gradient is not finite.
    pub fn update(&mut self, batch: &Batch<'_>, permutations: &[Vec<u32>]) -> Result<UpdateStatistics, UpdateFault> {
        self.check(batch, permutations)?;
        let size = self.settings.minibatch_size;
        let plan: Vec<_> = permutations
            .iter()
            .enumerate()
            .flat_map(|(epoch, rows)| rows.chunks(size).enumerate().map(move |(i, rows)| (epoch, i, rows)))
            .collect();

        let progress = Mutex::new(Progress::new(self));
        let learner = &*self;
        Team::run(self.threads, |team| {
            for &(epoch, index, rows) in &plan {
                learner.minibatch(team, batch, epoch, index, rows, &progress);
                let Some(adam) = lock(&progress).adam else { break };
                learner.steps(team, &adam);
            }
        });

        let progress = progress.into_inner().unwrap_or_else(PoisonError::into_inner);
        self.steps = progress.steps;
        self.learning_rate = progress.learning_rate;
        match progress.fault {
            Some(fault) => Err(fault),
            None => Ok(progress.statistics.mean(plan.len(), self.learning_rate)),
        }
    }

    fn check(&self, batch: &Batch<'_>, permutations: &[Vec<u32>]) -> Result<(), UpdateFault> {
        let samples = batch.returns.len();
        let actions = read(&self.log_std).values.len();
        let observations = self.networks[0].layers[0].inputs;
        for (name, slice, expected) in [
            ("observations", batch.observations, samples * observations),
            ("actions", batch.actions, samples * actions),
            ("means", batch.means, samples * actions),
            ("log_std", batch.log_std, actions),
            ("log_probs", batch.log_probs, samples),
            ("advantages", batch.advantages, samples),
        ] {
            if slice.len() != expected {
                return Err(UpdateFault::Shape {
                    name,
                    expected,
                    actual: slice.len(),
                });
            }
        }
        for (epoch, rows) in permutations.iter().enumerate() {
            if let Some(&sample) = rows.iter().find(|&&row| row as usize >= samples) {
                return Err(UpdateFault::Sample { epoch, sample, samples });
            }
        }
        Ok(())
    }

    /// Phases 1 and 2: leaves the gradient in the panels, and in `progress` the step to take.
    pub(super) fn minibatch(
        &self,
        team: &Team,
        batch: &Batch<'_>,
        epoch: usize,
        index: usize,
        rows: &[u32],
        progress: &Mutex<Progress>,
    ) {
        let (advantage_mean, advantage_scale) = advantage_normaliser(batch.advantages, rows);
        let minibatch = Minibatch {
            batch,
            settings: &self.settings,
            rows,
            advantage_mean,
            advantage_scale,
        };
        self.passes(team, &minibatch);
        self.gradients(team, rows.len(), || lock(progress).conclude(self, epoch, index, rows));
    }

    /// Phase 1: forward and backward pass of both networks, block by block.
    fn passes(&self, team: &Team, minibatch: &Minibatch<'_>) {
        let views = self
            .networks
            .each_ref()
            .map(|network| -> Vec<_> { network.layers.iter().map(PanelledLayer::view).collect() });
        let new = DiagonalGaussian::new(&read(&self.log_std).values);
        let kl = KlDivergence::new(&DiagonalGaussian::new(minibatch.batch.log_std), &new);
        let blocks = minibatch.rows.len().div_ceil(BLOCK);
        let task = |task: usize| {
            let (network, i) = (task / blocks, task % blocks);
            let rows = &minibatch.rows[i * BLOCK..minibatch.rows.len().min((i + 1) * BLOCK)];
            let mut block = write(&self.networks[network].blocks[i]);
            block.forward(self.arch, &views[network], minibatch.batch.observations, rows);
            match network {
                0 => block.policy_loss(minibatch, &new, &kl, rows),
                _ => block.value_loss(minibatch, rows),
            }
            block.backward(self.arch, &views[network]);
        };
        team.phase(2 * blocks, task, || ());
    }

    /// Phase 2: gradients of all panels from the deltas of all blocks.
    fn gradients(&self, team: &Team, rows: usize, conclude: impl FnOnce()) {
        let blocks = rows.div_ceil(BLOCK);
        let panels = self.panels();
        let task = |task: usize| {
            let (network, depth, i) = panels[task];
            let network = &self.networks[network];
            let layer = &network.layers[depth];
            let blocks: Vec<_> = network.blocks[..blocks].iter().map(read).collect();
            let stretches: Vec<_> = blocks
                .iter()
                .map(|block| Stretch {
                    depth: block.rows,
                    a: &block.activations[depth],
                    b: &block.deltas[depth][i * PANEL..],
                })
                .collect();
            let mut panel = write(&layer.panels[i]);
            self.arch.dispatch(Gradient {
                blocks: &stretches,
                x_stride: row_stride(layer.inputs),
                delta_stride: row_stride(layer.outputs),
                width: padded(panel_outputs(layer.outputs, i)),
                gradient: &mut panel.parameters.gradient,
            });
            panel.squares = self.arch.dispatch(SumOfSquares(&panel.parameters.gradient));
        };
        team.phase(panels.len(), task, conclude);
    }

    /// Phase 3: Adam.
    fn steps(&self, team: &Team, step: &AdamStep) {
        let panels = self.panels();
        let task = |task: usize| match panels.get(task) {
            Some(&(network, depth, i)) => {
                let layer = &self.networks[network].layers[depth];
                let mut panel = write(&layer.panels[i]);
                self.arch.dispatch(Adam {
                    parameters: &mut panel.parameters,
                    step,
                });
                panel.transpose(layer.inputs);
            }
            None => self.arch.dispatch(Adam {
                parameters: &mut write(&self.log_std),
                step,
            }),
        };
        team.phase(panels.len() + 1, task, || ());
    }

    /// (network, layer, panel) of every panel.
    fn panels(&self) -> Vec<(usize, usize, usize)> {
        let mut panels = Vec::new();
        for (network, layers) in self.networks.iter().map(|network| &network.layers).enumerate() {
            for (depth, layer) in layers.iter().enumerate() {
                panels.extend((0..layer.panels.len()).map(|i| (network, depth, i)));
            }
        }
        panels
    }
}

impl PanelledLayer {
    fn new(depth: usize, values: &Layer, first_moment: &Layer, second_moment: &Layer) -> Self {
        let (inputs, outputs) = (values.inputs(), values.outputs());
        let panel = |i| {
            let outputs = panel_outputs(outputs, i);
            let mut parameters = Parameters::zeros((inputs + 1) * padded(outputs));
            pack(values, i, &mut parameters.values);
            pack(first_moment, i, &mut parameters.first_moment);
            pack(second_moment, i, &mut parameters.second_moment);
            let transposed = Buffer::zeros(if depth == 0 { 0 } else { outputs * row_stride(inputs) });
            let mut panel = Panel {
                parameters,
                transposed,
                squares: 0.0,
            };
            panel.transpose(inputs);
            RwLock::new(panel)
        };
        Self {
            inputs,
            outputs,
            panels: (0..panel_count(outputs)).map(panel).collect(),
        }
    }

    fn view(&self) -> LayerView<'_> {
        LayerView {
            inputs: self.inputs,
            outputs: self.outputs,
            panels: self.panels.iter().map(read).collect(),
        }
    }

    fn unpacked(&self, part: fn(&Parameters) -> &Buffer) -> Layer {
        let mut layer = Layer::zeros(self.inputs, self.outputs);
        for (i, panel) in self.panels.iter().enumerate() {
            unpack(part(&read(panel).parameters), i, &mut layer);
        }
        layer
    }
}

/// What the minibatches of an update pass on.
pub(super) struct Progress {
    steps: u64,
    learning_rate: f64,
    /// Sums until the end.
    statistics: UpdateStatistics,
    /// The step to take; none after a fault.
    adam: Option<AdamStep>,
    fault: Option<UpdateFault>,
}

impl Progress {
    pub(super) fn new(learner: &Learner) -> Self {
        let Learner {
            steps, learning_rate, ..
        } = *learner;
        Self {
            steps,
            learning_rate,
            statistics: UpdateStatistics::default(),
            adam: None,
            fault: None,
        }
    }

    /// Between phases 2 and 3: sums up the minibatch and decides on the step.
    fn conclude(&mut self, learner: &Learner, epoch: usize, minibatch: usize, rows: &[u32]) {
        let settings = &learner.settings;
        let [policy, value] = learner
            .networks
            .each_ref()
            .map(|network| -> Vec<_> { network.blocks[..rows.len().div_ceil(BLOCK)].iter().map(read).collect() });
        let per_sample = 1.0 / rows.len() as f64;
        let policy_loss = policy.iter().map(|block| block.sums.policy_loss).sum::<f64>() * per_sample;
        let clip_fraction = policy.iter().map(|block| block.sums.clipped).sum::<f64>() * per_sample;
        let kl = policy.iter().map(|block| block.sums.kl).sum::<f64>() * per_sample;
        let value_loss = value.iter().map(|block| block.sums.value_loss).sum::<f64>() * per_sample;

        let mut log_std = write(&learner.log_std);
        for (i, gradient) in log_std.gradient.iter_mut().enumerate() {
            let sum: f64 = policy.iter().map(|block| block.sums.log_std_gradient[i]).sum();
            *gradient = (sum - settings.entropy_coefficient) as f32;
        }
        let mut squares = learner.arch.dispatch(SumOfSquares(&log_std.gradient));
        for layer in learner.networks.iter().flat_map(|network| &network.layers) {
            squares += layer.panels.iter().map(|panel| read(panel).squares).sum::<f64>();
        }
        let gradient_norm = squares.sqrt();

        if ![policy_loss, value_loss, kl, gradient_norm]
            .iter()
            .all(|x| x.is_finite())
        {
            let samples = rows.to_vec();
            self.fault = Some(UpdateFault::NotFinite {
                epoch,
                minibatch,
                samples,
                policy_loss,
                value_loss,
                kl,
                gradient_norm,
            });
            self.adam = None;
            return;
        }
        self.learning_rate = settings.adapted_learning_rate(self.learning_rate, kl);
        self.steps += 1;
        self.adam = Some(AdamStep::new(settings, self.steps, self.learning_rate, gradient_norm));

        let statistics = &mut self.statistics;
        statistics.policy_loss += policy_loss;
        statistics.value_loss += value_loss;
        statistics.entropy += DiagonalGaussian::new(&log_std.values).entropy();
        statistics.kl += kl;
        statistics.clip_fraction += clip_fraction;
        statistics.gradient_norm += gradient_norm;
        statistics.max_gradient_norm = statistics.max_gradient_norm.max(gradient_norm);
    }
}

impl UpdateStatistics {
    fn mean(self, minibatches: usize, learning_rate: f64) -> Self {
        let n = minibatches.max(1) as f64;
        Self {
            policy_loss: self.policy_loss / n,
            value_loss: self.value_loss / n,
            entropy: self.entropy / n,
            kl: self.kl / n,
            clip_fraction: self.clip_fraction / n,
            gradient_norm: self.gradient_norm / n,
            max_gradient_norm: self.max_gradient_norm,
            learning_rate,
        }
    }
}

// Locks are never left poisoned with half-written data in use: a panic ends the whole team.

fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

fn lock<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

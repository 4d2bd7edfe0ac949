//! The candle learner: one PPO update, line by line.

use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor, Var};
use candle_nn::Optimizer;

use super::networks::{numbers, tensors};
use super::{CandleAdam, CandleNetworks, Loss};
use crate::config::{LOG_STD_RANGE, Ppo};
use crate::network::ActorCritic;
use crate::ppo::loss::Minibatch;
use crate::ppo::update::{UpdateProgress, check};
use crate::ppo::{Batch, Learner, LearnerState, UpdateFault, UpdateStatistics};
use crate::ranks::Alone;

/// Divergences below this count as zero: candle's means differ from those of the rollout in their last bits, which must
/// not look like a policy that changes too little (see `adapted_learning_rate`). One gradient step with the
/// lowest learning rate changes it by a hundred times more.
const KL_ROUNDING: f64 = 1e-8;

/// The readable learner: trains an [`ActorCritic`] by PPO with candle's networks and gradients.
///
/// Its state is plain numbers; candle's variables live for one update.
#[derive(Debug)]
pub struct CandleLearner {
    settings: Ppo,
    state: LearnerState,
}

impl CandleLearner {
    /// Creates a learner that continues from `state`.
    ///
    /// # Panics
    /// The minibatch size is zero, or there is more than one shard.
    pub fn new(state: LearnerState, settings: Ppo) -> Self {
        assert!(settings.minibatch_size > 0, "a minibatch needs samples");
        assert_eq!(settings.shards, 1, "candle sums over a minibatch as it likes");
        Self { settings, state }
    }

    /// Runs the update: for each minibatch loss, gradient, clipping, learning rate, and a step of Adam.
    fn epochs(&mut self, batch: &Batch<'_>, permutations: &[Vec<u32>]) -> Result<UpdateStatistics, UpdateFault> {
        let Self { settings, state } = self;
        let networks = CandleNetworks::new(&state.parameters, DType::F32)?;
        let mut adam = CandleAdam::new(networks.variables.clone(), settings.clone())?;
        adam.first_moment = tensors(&state.first_moment)?;
        adam.second_moment = tensors(&state.second_moment)?;
        adam.steps = state.steps;
        let minibatches = Minibatch::all(batch, settings, permutations, &Alone);
        let mut progress = UpdateProgress::new(state.steps, state.learning_rate, minibatches.len());

        for minibatch in minibatches {
            let loss = Loss::new(&networks, &minibatch)?;
            let mut gradients = loss.total.backward()?;
            let norm = norm(&gradients, &networks.variables)?;
            progress.conclude(&minibatch, statistics(&loss, norm, settings)?);
            let Some(step) = progress.step else { break };
            scale(&mut gradients, &networks.variables, step.gradient_scale)?;
            adam.set_learning_rate(step.learning_rate);
            adam.step(&gradients)?;
            networks.log_std.set(&networks.log_std.detach().clamp(LOG_STD_RANGE[0], LOG_STD_RANGE[1])?)?;
        }

        let parameters = &state.parameters;
        *state = LearnerState {
            first_moment: numbers(parameters, &adam.first_moment)?,
            second_moment: numbers(parameters, &adam.second_moment)?,
            parameters: numbers(parameters, networks.variables.iter().map(Var::as_tensor))?,
            steps: progress.steps,
            learning_rate: progress.learning_rate,
        };
        progress.fault.map_or(Ok(progress.statistics), Err)
    }
}

impl Learner for CandleLearner {
    fn set_entropy_coefficient(&mut self, weight: f64) {
        self.settings.entropy_coefficient = weight;
    }

    fn update(&mut self, batch: &Batch<'_>, permutations: &[Vec<u32>]) -> Result<UpdateStatistics, UpdateFault> {
        check(batch, permutations, &self.state.parameters, &self.settings, &Alone)?;
        // One thread: the products of single layers are so small that waking others costs more than it saves.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let pool = pool.map_err(|error| UpdateFault::Candle(error.to_string()))?;
        pool.install(|| self.epochs(batch, permutations))
    }

    fn state(&self) -> LearnerState {
        self.state.clone()
    }

    fn parameters(&self) -> ActorCritic {
        self.state.parameters.clone()
    }
}

/// Returns the norm of the joint gradient.
fn norm(gradients: &GradStore, variables: &[Var]) -> candle_core::Result<f64> {
    let squares = variables
        .iter()
        .filter_map(|variable| gradients.get(variable))
        .map(|gradient| scalar(&gradient.sqr()?.sum_all()?));
    Ok(squares.sum::<candle_core::Result<f64>>()?.sqrt())
}

fn scale(gradients: &mut GradStore, variables: &[Var], factor: f64) -> candle_core::Result<()> {
    for variable in variables {
        if let Some(gradient) = gradients.remove(variable) {
            gradients.insert(variable, (gradient * factor)?);
        }
    }
    Ok(())
}

fn statistics(loss: &Loss, gradient_norm: f64, settings: &Ppo) -> candle_core::Result<UpdateStatistics> {
    let ratios = loss.ratio.to_vec1::<f64>()?;
    let clipped = ratios.iter().filter(|&ratio| (ratio - 1.0).abs() > settings.clip_range).count();
    let kl = scalar(&loss.kl)?;
    Ok(UpdateStatistics {
        policy_loss: scalar(&loss.policy)?,
        value_loss: scalar(&loss.value)?,
        entropy: scalar(&loss.entropy)?,
        kl: if kl.abs() < KL_ROUNDING { 0.0 } else { kl },
        clip_fraction: clipped as f64 / ratios.len() as f64,
        // Finite, so that it can be logged.
        max_ratio: ratios.iter().copied().fold(0.0, f64::max).min(f64::MAX),
        gradient_norm,
        max_gradient_norm: gradient_norm,
        learning_rate: 0.0,
    })
}

fn scalar(tensor: &Tensor) -> candle_core::Result<f64> {
    tensor.to_dtype(DType::F64)?.to_scalar()
}

//! The interface of the two learners, and the choice between them.

use std::fmt::Debug;
use std::sync::Arc;
use std::time::Duration;

#[cfg(tiles)]
use super::fused::Tiles;
use super::fused::{Panels, tiles_available};
use super::{Batch, CandleLearner, FusedLearner, UpdateFault, UpdateStatistics, candle, fused};
use crate::config::{LearnerKind, Ppo, Precision};
use crate::network::ActorCritic;
use crate::ranks::Ranks;

/// A learner that trains an [`ActorCritic`] by PPO.
///
/// ```
/// use supple::{config::Config, network::ActorCritic, ranks::Alone, util::random::{Purpose, stream}};
/// use supple::ppo::{DiagonalGaussian, LearnerState, Samples, learner};
///
/// let mut ppo = Config::load("fast")?.ppo;
/// ppo.minibatch_size = 4;
/// let network = ActorCritic::orthogonal(3, &[8], 2, -1.0, &mut stream(0, Purpose::Weights, 0, 0));
/// let mut learner = learner(&ppo, LearnerState::new(network, &ppo), 1, Alone::shared())?;
/// let log_std = vec![-1.0; 2];
/// let log_prob = DiagonalGaussian::new(&log_std).log_prob(&[0.0; 2], &[0.1; 2]) as f32;
/// let batch = Samples { observations: vec![0.5; 12], actions: vec![0.1; 8], means: vec![0.0; 8], log_std,
///     log_probs: vec![log_prob; 4], advantages: vec![1.0, -1.0, 2.0, -2.0], returns: vec![1.0; 4],
///     ..Samples::default() };
/// learner.update(&batch.batch(), &[vec![0, 1, 2, 3], vec![3, 2, 1, 0]])?; // two epochs of one minibatch
/// assert_eq!(learner.state().steps, 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Learner: Debug + Send {
    /// Runs one PPO update: for each of `permutations` one epoch over the batch in that order, a gradient step for each
    /// `minibatch_size` samples and one for the rest. With several shards, batch and permutations are those of this
    /// rank's shards, each minibatch shard by shard.
    ///
    /// # Errors
    /// The batch or a permutation does not fit, or the loss or its gradient is not finite. Steps before the fault are
    /// kept.
    fn update(&mut self, batch: &Batch<'_>, permutations: &[Vec<u32>]) -> Result<UpdateStatistics, UpdateFault>;

    /// Sets the weight of the entropy bonus of the next updates; at first that of the configuration.
    fn set_entropy_coefficient(&mut self, weight: f64);

    /// Returns a copy of the complete state, from which training continues with the same bits.
    fn state(&self) -> LearnerState;

    /// Returns a copy of the networks.
    fn parameters(&self) -> ActorCritic;

    /// Returns the time of the last update in which threads worked together.
    fn together(&self) -> Together {
        Together::default()
    }
}

/// A time in which threads work together.
#[derive(Debug, Clone, Copy, Default)]
pub struct Together {
    /// The time on the clock.
    pub wall: Duration,
    /// The time that a thread waits in it for others, mean over the threads.
    pub waiting: Duration,
}

/// Creates the learner of a configuration, which continues from `state`. The number of threads changes only the speed.
///
/// # Errors
/// The processor does not support the precision.
///
/// # Panics
/// The minibatch size is zero, the moments do not have the shapes of the parameters, or candle's learner should use
/// shards.
pub fn learner(
    ppo: &Ppo,
    state: LearnerState,
    threads: usize,
    ranks: Arc<dyn Ranks>,
) -> Result<Box<dyn Learner>, PrecisionError> {
    let settings = ppo.clone();
    Ok(match (ppo.learner, resolved(ppo)) {
        (LearnerKind::Candle, _) => Box::new(CandleLearner::new(state, settings)),
        (LearnerKind::Fused, Precision::Auto | Precision::F32) => {
            Box::new(FusedLearner::<Panels>::new(&state, settings, threads, ranks))
        }
        #[cfg(tiles)]
        (LearnerKind::Fused, Precision::Mixed) if tiles_available() => {
            Box::new(FusedLearner::<Tiles>::new(&state, settings, threads, ranks))
        }
        (LearnerKind::Fused, Precision::Mixed) => return Err(PrecisionError),
    })
}

/// Optional keys of `ppo` that all learners use, or that the trainer uses for them.
const OPTIONAL_KEYS: &[&str] = &["learner", "precision", "final_entropy_coefficient"];

impl LearnerKind {
    /// Returns true if the learner uses an optional key of `ppo`. A configuration that states another one is refused.
    pub(crate) fn knows(self, key: &str) -> bool {
        let own = match self {
            LearnerKind::Fused => fused::OPTIONAL_KEYS,
            LearnerKind::Candle => candle::OPTIONAL_KEYS,
        };
        OPTIONAL_KEYS.contains(&key) || own.contains(&key)
    }
}

/// Resolves `ppo.precision` on this machine; never returns [`Precision::Auto`].
pub fn resolved(ppo: &Ppo) -> Precision {
    match ppo.precision {
        Precision::Auto if ppo.learner != LearnerKind::Candle && tiles_available() => Precision::Mixed,
        Precision::Auto => Precision::F32,
        precision => precision,
    }
}

/// The error of a precision that this processor does not support.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "ppo.precision is mixed, but this processor has no tile unit for bf16 (AMX): resume on a processor that has one, \
     or start a run with ppo.precision: f32"
)]
pub struct PrecisionError;

/// Complete state of a learner, as stored in a checkpoint.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnerState {
    /// Weights of the policy and the value function.
    pub parameters: ActorCritic,
    /// Adam's first moments, one for each parameter.
    pub first_moment: ActorCritic,
    /// Adam's second moments, one for each parameter.
    pub second_moment: ActorCritic,
    /// Number of gradient steps taken.
    pub steps: u64,
    /// Learning rate of the last gradient step.
    pub learning_rate: f64,
}

impl LearnerState {
    /// Returns the state before the first update.
    pub fn new(parameters: ActorCritic, settings: &Ppo) -> Self {
        let (first_moment, second_moment) = (parameters.zeros_like(), parameters.zeros_like());
        Self { parameters, first_moment, second_moment, steps: 0, learning_rate: settings.initial_learning_rate }
    }
}

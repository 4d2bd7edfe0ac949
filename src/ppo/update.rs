//! The parts of an update that all learners share: from the sums of a minibatch to its step, statistics or fault.

use serde::{Deserialize, Serialize};

use super::Batch;
use super::loss::{Minibatch, adapted_learning_rate};
use crate::config::Ppo;
use crate::network::ActorCritic;
use crate::ranks::Ranks;

/// Statistics of an update: means over its minibatches unless stated otherwise.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct UpdateStatistics {
    /// Policy loss: the negated clipped surrogate.
    pub policy_loss: f64,
    /// Mean squared error of the values.
    pub value_loss: f64,
    /// Entropy of the policy.
    pub entropy: f64,
    /// KL divergence from the policy of the rollout.
    pub kl: f64,
    /// Fraction of samples with a probability ratio outside the clip range.
    pub clip_fraction: f64,
    /// Largest probability ratio of a sample, over all minibatches.
    pub max_ratio: f64,
    /// Norm of the joint gradient before clipping.
    pub gradient_norm: f64,
    /// Largest norm of the joint gradient before clipping.
    pub max_gradient_norm: f64,
    /// Adapted learning rate.
    pub learning_rate: f64,
}

/// The reason why an update stopped. Earlier steps are kept, except after an error of candle.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UpdateFault {
    /// The slices of the batch, the permutations of its samples and the shards do not fit.
    #[error("{0}")]
    Misfit(String),
    /// The loss, the divergence or the gradient is infinite or NaN.
    #[error("minibatch {minibatch} of epoch {epoch} is not finite: {summary:?}")]
    NotFinite {
        /// Index of the epoch, counted from zero.
        epoch: usize,
        /// Index of the minibatch within the epoch, counted from zero.
        minibatch: usize,
        /// Indices of the minibatch's samples.
        samples: Vec<u32>,
        /// Statistics of the minibatch.
        summary: UpdateStatistics,
    },
    /// Candle failed; the parameters are those before the update.
    #[error("candle: {0}")]
    Candle(String),
}

impl From<candle_core::Error> for UpdateFault {
    fn from(error: candle_core::Error) -> Self {
        UpdateFault::Candle(error.to_string())
    }
}

/// Adam's decay rates of the first and the second moment; the defaults, which neither the paper nor Stable-Baselines3
/// changes.
pub const ADAM_BETAS: [f64; 2] = [0.9, 0.999];

/// State passed from one minibatch of an update to the next.
#[derive(Debug)]
pub struct UpdateProgress {
    pub steps: u64,
    pub learning_rate: f64,
    pub statistics: UpdateStatistics,
    /// Number of minibatches in the update.
    count: usize,
    /// The step to take; `None` after a fault.
    pub step: Option<OptimizerStep>,
    pub fault: Option<UpdateFault>,
}

/// The parts of a gradient step that all learners share.
#[derive(Debug, Clone, Copy)]
pub struct OptimizerStep {
    /// Number of the step, counted from one.
    pub count: u64,
    pub learning_rate: f64,
    /// Factor that clips the norm of the joint gradient.
    pub gradient_scale: f64,
}

impl OptimizerStep {
    /// Computes the scalars of a step for a joint gradient of norm `gradient_norm`.
    pub fn new(settings: &Ppo, count: u64, learning_rate: f64, gradient_norm: f64) -> Self {
        let gradient_scale = (settings.max_gradient_norm / (gradient_norm + 1e-6)).min(1.0);
        Self { count, learning_rate, gradient_scale }
    }
}

impl UpdateProgress {
    /// Creates the progress at the start of an update of `count` minibatches.
    pub fn new(steps: u64, learning_rate: f64, count: usize) -> Self {
        Self { steps, learning_rate, statistics: UpdateStatistics::default(), count, step: None, fault: None }
    }

    /// Determines the step of `minibatch` from its statistics, or records the fault.
    pub fn conclude(&mut self, minibatch: &Minibatch<'_>, mut summary: UpdateStatistics) {
        let Minibatch { epoch, index, rows, settings, .. } = *minibatch;
        summary.learning_rate = adapted_learning_rate(settings, self.learning_rate, summary.kl);
        if summary.is_finite() {
            self.learning_rate = summary.learning_rate;
            self.steps += 1;
            self.step = Some(OptimizerStep::new(settings, self.steps, self.learning_rate, summary.gradient_norm));
            self.statistics.add(&summary, 1.0 / self.count as f64);
        } else {
            self.step = None;
            self.fault = Some(UpdateFault::NotFinite { epoch, minibatch: index, samples: rows.to_vec(), summary });
        }
    }
}

impl UpdateStatistics {
    fn is_finite(&self) -> bool {
        [self.policy_loss, self.value_loss, self.entropy, self.kl, self.gradient_norm].iter().all(|x| x.is_finite())
    }

    /// Adds the statistics of a minibatch with a weight.
    fn add(&mut self, minibatch: &Self, weight: f64) {
        self.policy_loss += weight * minibatch.policy_loss;
        self.value_loss += weight * minibatch.value_loss;
        self.entropy += weight * minibatch.entropy;
        self.kl += weight * minibatch.kl;
        self.clip_fraction += weight * minibatch.clip_fraction;
        self.max_ratio = self.max_ratio.max(minibatch.max_ratio);
        self.gradient_norm += weight * minibatch.gradient_norm;
        self.max_gradient_norm = self.max_gradient_norm.max(minibatch.max_gradient_norm);
        self.learning_rate += weight * minibatch.learning_rate;
    }
}

/// Checks that slices have lengths that fit the networks, and that permutations stay within the batch and can be divided among the
/// shards.
pub fn check(
    batch: &Batch<'_>,
    permutations: &[Vec<u32>],
    networks: &ActorCritic,
    settings: &Ppo,
    ranks: &dyn Ranks,
) -> Result<(), UpdateFault> {
    let samples = batch.returns.len();
    let (observations, actions) = (networks.policy.inputs(), networks.policy.outputs());
    for (name, slice, expected) in [
        ("observations", batch.observations, samples * observations),
        ("critic_observations", batch.value_inputs(), samples * networks.value.inputs()),
        ("actions", batch.actions, samples * actions),
        ("means", batch.means, samples * actions),
        ("log_std", batch.log_std, actions),
        ("log_probs", batch.log_probs, samples),
        ("advantages", batch.advantages, samples),
    ] {
        if slice.len() != expected {
            let found = slice.len();
            let problem = format!("{name} of the batch should have {expected} elements, but has {found}");
            return Err(UpdateFault::Misfit(problem));
        }
    }
    for (epoch, rows) in permutations.iter().enumerate() {
        if let Some(&sample) = rows.iter().find(|&&row| row as usize >= samples) {
            let problem = format!("the permutation of epoch {epoch} names sample {sample} of only {samples}");
            return Err(UpdateFault::Misfit(problem));
        }
        let shards = settings.shards / ranks.count();
        let mut sizes = rows.chunks(settings.minibatch_size / ranks.count()).map(<[u32]>::len);
        if let Some(rows) = sizes.find(|rows| rows % shards != 0) {
            return Err(UpdateFault::Misfit(format!(
                "the permutation of epoch {epoch} leaves {rows} samples for {shards} shards, which do not divide them"
            )));
        }
    }
    Ok(())
}

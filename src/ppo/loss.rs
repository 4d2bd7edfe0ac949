/*! PPO's arithmetic per sample: minibatches, normalised advantages, the clipped surrogate.

Settings are those of the configuration; the number of epochs is the number of permutations given to an update.
*/

use crate::config::Ppo;
use crate::ranks::{Ranks, tree_sum};

/// Returns a weight after this part of the run, 0 to 1: linear from the first to the last, if there is a last.
pub fn weight_after(first: f64, last: Option<f64>, part: f64) -> f64 {
    first + part.min(1.0) * (last.unwrap_or(first) - first)
}

/// Returns the learning rate for a step at which the policy has the divergence `kl` from the rollout's (Rudin et
/// al., 2021): divided by 1.5 above twice the desired divergence, multiplied by 1.5 below half of it. As in rsl_rl,
/// a divergence of exactly zero (the first minibatch of an update) changes nothing.
pub fn adapted_learning_rate(settings: &Ppo, learning_rate: f64, kl: f64) -> f64 {
    if kl > 2.0 * settings.desired_kl {
        (learning_rate / 1.5).max(settings.min_learning_rate)
    } else if kl > 0.0 && kl < 0.5 * settings.desired_kl {
        (learning_rate * 1.5).min(settings.max_learning_rate)
    } else {
        learning_rate
    }
}

/// The samples of an update, borrowed: n samples in any order.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// Normalised observations, shape (n, observations).
    pub observations: &'a [f32],
    /// Normalised observations of the critic, shape (n, critic's observations); empty if they are those of the policy.
    pub critic_observations: &'a [f32],
    /// Actions as sampled, not clipped; shape (n, actions).
    pub actions: &'a [f32],
    /// Mean actions of the policy that sampled; shape (n, actions).
    pub means: &'a [f32],
    /// `ln σ` of the policy that sampled; shape (actions).
    pub log_std: &'a [f32],
    /// Log-probabilities of the actions under the policy that sampled; shape (n).
    pub log_probs: &'a [f32],
    /// Advantages, not normalised; shape (n).
    pub advantages: &'a [f32],
    /// Targets of the value function; shape (n).
    pub returns: &'a [f32],
}

impl Batch<'_> {
    /// Returns what the value function observes, shape (n, its inputs).
    pub fn value_inputs(&self) -> &[f32] {
        if self.critic_observations.is_empty() { self.observations } else { self.critic_observations }
    }

    /// Prefetches the numbers of these samples.
    pub(super) fn prefetch(&self, samples: &[u32], prefetch: fn(&[f32])) {
        let count = self.returns.len();
        let Batch { observations, critic_observations, actions, means, log_probs, advantages, returns, .. } = *self;
        for slice in [observations, critic_observations, actions, means, log_probs, advantages, returns] {
            let width = slice.len() / count;
            samples.iter().for_each(|sample| prefetch(&slice[*sample as usize * width..][..width]));
        }
    }
}

/// A batch that owns its numbers; the fields are those of [`Batch`].
#[derive(Debug, Clone, Default)]
#[allow(missing_docs)]
pub struct Samples {
    pub observations: Vec<f32>,
    pub critic_observations: Vec<f32>,
    pub actions: Vec<f32>,
    pub means: Vec<f32>,
    pub log_std: Vec<f32>,
    pub log_probs: Vec<f32>,
    pub advantages: Vec<f32>,
    pub returns: Vec<f32>,
}

impl Samples {
    /// Borrows the samples as a batch.
    pub fn batch(&self) -> Batch<'_> {
        let (observations, critic_observations) = (&self.observations, &self.critic_observations);
        let (actions, means, log_std, log_probs) = (&self.actions, &self.means, &self.log_std, &self.log_probs);
        let (advantages, returns) = (&self.advantages, &self.returns);
        Batch { observations, critic_observations, actions, means, log_std, log_probs, advantages, returns }
    }
}

/// A minibatch of an update. With several ranks, each has the rows of its own shards.
#[derive(Debug, Clone, Copy)]
pub struct Minibatch<'a> {
    pub batch: &'a Batch<'a>,
    pub settings: &'a Ppo,
    /// Index of the epoch, counted from zero.
    pub epoch: usize,
    /// Index within the epoch, counted from zero.
    pub index: usize,
    /// The minibatch's samples on this rank, shard by shard.
    pub rows: &'a [u32],
    /// Number of shards on this rank, which have equally many rows.
    pub shards: usize,
    /// Number of samples on all ranks.
    pub samples: usize,
    advantage_mean: f64,
    /// Factor that normalises advantages: 1 / (unbiased standard deviation + 1e-8).
    advantage_scale: f64,
}

impl<'a> Minibatch<'a> {
    /// Iterates over the minibatches of an update: for each of `permutations` an epoch over the batch in that order,
    /// whose last minibatch has the rest. A single sample is not normalised, as in Stable-Baselines3.
    pub fn all(batch: &'a Batch<'a>, settings: &'a Ppo, permutations: &'a [Vec<u32>], ranks: &dyn Ranks) -> Vec<Self> {
        let count = ranks.count();
        let of_epoch = |(epoch, order): (usize, &'a Vec<u32>)| {
            order.chunks(settings.minibatch_size / count).enumerate().map(move |(index, rows)| Self {
                batch,
                settings,
                epoch,
                index,
                rows,
                shards: settings.shards / count,
                samples: rows.len() * count,
                advantage_mean: 0.0,
                advantage_scale: 1.0,
            })
        };
        let mut all: Vec<Self> = permutations.iter().enumerate().flat_map(of_epoch).collect();
        let sums = |all: &[Self], of: fn(&Self, f64) -> f64| {
            let mut sums: Vec<f64> = all.iter().map(|minibatch| minibatch.sum_of_advantages(of)).collect();
            ranks.sum(&mut Vec::new(), &mut sums);
            sums
        };
        let means = sums(&all, |_, advantage| advantage);
        for (minibatch, sum) in all.iter_mut().zip(means).filter(|(minibatch, _)| minibatch.samples > 1) {
            minibatch.advantage_mean = sum / minibatch.samples as f64;
        }
        let squares = sums(&all, |minibatch, advantage| (advantage - minibatch.advantage_mean).powi(2));
        for (minibatch, squares) in all.iter_mut().zip(squares).filter(|(minibatch, _)| minibatch.samples > 1) {
            minibatch.advantage_scale = 1.0 / ((squares / (minibatch.samples as f64 - 1.0)).sqrt() + 1e-8);
        }
        all
    }

    fn sum_of_advantages(&self, of: fn(&Self, f64) -> f64) -> f64 {
        let size = self.rows.len() / self.shards;
        tree_sum(self.shards, |shard| {
            let rows = &self.rows[shard * size..][..size];
            rows.iter().map(|row| of(self, f64::from(self.batch.advantages[*row as usize]))).sum()
        })
    }

    /// Returns the number of blocks of `size` rows in each shard, of which the last may have fewer.
    pub fn shard_blocks(&self, size: usize) -> usize {
        (self.rows.len() / self.shards).div_ceil(size)
    }

    /// Returns the samples of one block of `size`, counted through all shards.
    pub fn block(&self, size: usize, index: usize) -> &'a [u32] {
        let (rows, blocks) = (self.rows.len() / self.shards, self.shard_blocks(size));
        let (shard, start) = (index / blocks, index % blocks * size);
        &self.rows[shard * rows..][start..rows.min(start + size)]
    }

    /// Returns the value of a sample's state in the rollout, `V_old`: its return minus its advantage. A mirror image has that of
    /// its original.
    pub fn old_value(&self, row: usize) -> f64 {
        f64::from(self.batch.returns[row]) - f64::from(self.batch.advantages[row])
    }

    /// Returns the normalised advantage of a sample.
    pub fn advantage(&self, row: usize) -> f64 {
        (f64::from(self.batch.advantages[row]) - self.advantage_mean) * self.advantage_scale
    }
}

/// The clipped surrogate of one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surrogate {
    /// The loss `−min(A·r, A·clip(r, 1 − c, 1 + c))`.
    pub loss: f64,
    /// Derivative of the loss by the log-probability.
    pub slope: f64,
    /// True if `r` lies outside 1 ± c.
    pub clipped: bool,
}

impl Surrogate {
    /// Computes the surrogate for normalised advantage `A`, probability ratio `r` and clip range `c`.
    pub fn new(advantage: f64, ratio: f64, clip_range: f64) -> Self {
        let free = advantage * ratio;
        let limited = advantage * ratio.clamp(1.0 - clip_range, 1.0 + clip_range);
        // `limited` is constant in `r` wherever it is the smaller one.
        let (loss, slope) = if limited < free { (-limited, 0.0) } else { (-free, -free) };
        Self { loss, slope, clipped: (ratio - 1.0).abs() > clip_range }
    }
}

#[cfg(test)]
pub(in crate::ppo) mod tests {
    use super::*;
    use crate::config::Config;
    use crate::ranks::Alone;

    /// Returns the settings of the paper.
    pub fn settings() -> Ppo {
        Config::load("compliant").unwrap().ppo
    }

    #[test]
    fn surrogate_takes_the_smaller_of_the_free_and_the_clipped_gain() {
        let surrogate = |advantage, ratio| {
            let Surrogate { loss, slope, clipped } = Surrogate::new(advantage, ratio, 0.25);
            (loss, slope, clipped)
        };
        assert_eq!(surrogate(2.0, 1.5), (-2.5, 0.0, true)); // min(2·1.5, 2·1.25) = 2.5, no gain in going further
        assert_eq!(surrogate(2.0, 0.5), (-1.0, -1.0, true)); // min(2·0.5, 2·0.75) = 1, free
        assert_eq!(surrogate(-2.0, 1.5), (3.0, 3.0, true)); // min(−2·1.5, −2·1.25) = −3, free
        assert_eq!(surrogate(-2.0, 0.5), (1.5, 0.0, true)); // min(−2·0.5, −2·0.75) = −1.5, clipped
        assert_eq!(surrogate(2.0, 1.125), (-2.25, -2.25, false)); // inside the range
    }

    #[test]
    fn surrogate_of_a_nan_is_a_nan() {
        assert!(Surrogate::new(f64::NAN, 1.0, 0.2).loss.is_nan());
        assert!(Surrogate::new(1.0, f64::NAN, 0.2).loss.is_nan());
    }

    /// Creates a batch with only advantages.
    fn of_advantages(advantages: &[f32]) -> Batch<'_> {
        let [observations, critic_observations, actions, means, log_std, log_probs, returns] = [&[] as &[f32]; 7];
        Batch { observations, critic_observations, actions, means, log_std, log_probs, advantages, returns }
    }

    #[test]
    fn advantages_are_normalised_with_the_unbiased_standard_deviation() {
        let batch = &of_advantages(&[1.0, 100.0, 3.0, 8.0]);
        // Rows 3, 0, 2: 8, 1, 3; mean 4; variance (16 + 9 + 1)/2 = 13.
        let (settings, orders) = (&settings(), [vec![3, 0, 2], vec![3]]);
        let minibatches = Minibatch::all(batch, settings, &orders, &Alone);
        assert!((minibatches[0].advantage(3) - 4.0 / (13.0_f64.sqrt() + 1e-8)).abs() < 1e-15);
        assert_eq!(minibatches[1].advantage(3), 8.0);
    }

    #[test]
    fn blocks_do_not_reach_across_shards() {
        let batch = &of_advantages(&[0.0; 10]);
        let (settings, orders) = (Ppo { shards: 2, ..settings() }, [(0..10).collect::<Vec<u32>>()]);
        let minibatch = Minibatch::all(batch, &settings, &orders, &Alone)[0];
        let blocks: Vec<&[u32]> = (0..2 * minibatch.shard_blocks(3)).map(|block| minibatch.block(3, block)).collect();
        assert_eq!(blocks, [&[0, 1, 2][..], &[3, 4], &[5, 6, 7], &[8, 9]]);
    }

    #[test]
    fn a_weight_changes_linearly_if_a_last_one_is_given() {
        let weights = [0.0, 0.25, 1.0, 1.5].map(|part| weight_after(0.01, Some(0.002), part));
        let expected = [0.01, 0.008, 0.002, 0.002];
        assert!(weights.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{weights:?}");
        assert_eq!(weight_after(0.01, None, 0.7), 0.01);
    }

    #[test]
    fn learning_rate_follows_the_divergence_within_its_limits() {
        let settings = settings();
        let rate = |learning_rate, kl| adapted_learning_rate(&settings, learning_rate, kl);
        assert_eq!(rate(3e-3, 0.041), 2e-3);
        assert_eq!(rate(2e-3, 0.009), 3e-3);
        assert_eq!(rate(2e-3, 0.02), 2e-3);
        assert_eq!(rate(1.2e-5, 1.0), 1e-5);
        assert_eq!(rate(9e-3, 1e-6), 1e-2);
        assert_eq!(rate(2e-3, 0.0), 2e-3);
    }
}

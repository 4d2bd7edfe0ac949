//! The losses of a block of rows, and their gradients by the networks' outputs.

use crate::ppo::loss::{Minibatch, Surrogate};
use crate::ppo::{DiagonalGaussian, KlDivergence};

/// Optional keys of `ppo` that this learner alone uses; the others are refused.
pub const OPTIONAL_KEYS: &[&str] = &["shards"];

/// A block of rows between its forward and its backward pass.
pub struct Pass<'a> {
    /// Index of the network: 0 for the policy, 1 for the value function.
    pub network: usize,
    /// Index of the block within the minibatch, counted from zero.
    pub block: usize,
    /// Distance between rows of `outputs` and `deltas` \[numbers\].
    pub stride: usize,
    /// Outputs of the network, shape (rows, outputs); the last block may have fewer rows.
    pub outputs: &'a [f32],
    /// Gradient of the loss by the outputs, to be written; same shape.
    pub deltas: &'a mut [f32],
}

/// Sums of the losses over rows.
#[derive(Debug, Clone, Default)]
pub struct Sums {
    pub policy_loss: f64,
    pub value_loss: f64,
    pub kl: f64,
    pub clipped: f64,
    /// Largest probability ratio (not a sum).
    pub max_ratio: f64,
    /// Gradient of the policy loss by `ln σ`, shape (actions).
    pub log_std_gradient: Vec<f64>,
}

impl<'a> Pass<'a> {
    /// Splits the block into parts of `rows` rows.
    pub fn parts(self, rows: usize) -> impl Iterator<Item = Pass<'a>> {
        let Pass { network, block, stride, outputs, deltas } = self;
        let parts = outputs.chunks(rows * stride).zip(deltas.chunks_mut(rows * stride));
        parts.map(move |(outputs, deltas)| Pass { network, block, stride, outputs, deltas })
    }

    /// Computes the policy loss of `rows` and its gradient by the means and `ln σ`.
    pub fn policy_loss(self, minibatch: &Minibatch, rows: &[u32], new: &DiagonalGaussian, kl: &KlDivergence) -> Sums {
        let Minibatch { batch, settings, .. } = *minibatch;
        let actions = batch.log_std.len();
        let mut sums = Sums { log_std_gradient: vec![0.0; actions], ..Sums::default() };
        for ((mean, delta), &row) in self.outputs.chunks(self.stride).zip(self.deltas.chunks_mut(self.stride)).zip(rows)
        {
            let row = row as usize;
            let mean = &mean[..actions];
            let action = &batch.actions[row * actions..][..actions];
            let ratio = (new.log_prob(mean, action) - f64::from(batch.log_probs[row])).exp();
            let surrogate = Surrogate::new(minibatch.advantage(row), ratio, settings.clip_range);
            sums.policy_loss += surrogate.loss;
            sums.clipped += f64::from(surrogate.clipped);
            // Finite, so that it can be logged.
            sums.max_ratio = sums.max_ratio.max(ratio.min(f64::MAX));
            sums.kl += kl.at(&batch.means[row * actions..][..actions], mean);

            let slope = surrogate.slope / minibatch.samples as f64;
            for (i, inverse_std) in new.inverse_std().iter().enumerate() {
                let z = (f64::from(action[i]) - f64::from(mean[i])) * inverse_std;
                delta[i] = (slope * z * inverse_std) as f32;
                sums.log_std_gradient[i] += slope * (z * z - 1.0);
            }
        }
        sums
    }

    /// Computes the value loss of `rows` and its gradient by the values.
    pub fn value_loss(self, minibatch: &Minibatch<'_>, rows: &[u32]) -> Sums {
        let scale = 2.0 * minibatch.settings.value_coefficient / minibatch.samples as f64;
        let mut value_loss = 0.0;
        for ((value, delta), &row) in
            self.outputs.chunks(self.stride).zip(self.deltas.chunks_mut(self.stride)).zip(rows)
        {
            let error = f64::from(value[0]) - f64::from(minibatch.batch.returns[row as usize]);
            value_loss += error * error;
            delta[0] = (scale * error) as f32;
        }
        Sums { value_loss, ..Sums::default() }
    }
}

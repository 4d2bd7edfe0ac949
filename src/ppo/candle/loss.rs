/*! PPO's loss as in textbooks, computed with candle.

Schulman et al., "Proximal Policy Optimization Algorithms", eq. 7 and 9, as implemented by Stable-Baselines3. All of it
is in f64, whatever the networks use: the KL rule compares numbers near zero.
*/

use candle_core::{D, Device, Result, Tensor};

use super::CandleNetworks;
use crate::ppo::loss::Minibatch;

/// Optional keys of `ppo` that this learner alone uses; the others are refused.
pub const OPTIONAL_KEYS: &[&str] = &[];

/// The terms of the loss over a minibatch, and statistics; scalars unless another shape is given.
pub struct Loss {
    /// Total loss `policy + value_coefficient · value − entropy_coefficient · entropy`.
    pub total: Tensor,
    /// Policy loss `−mean(min(A·r, A·clip(r, 1 − c, 1 + c)))`.
    pub policy: Tensor,
    /// Value loss `mean((V − R)²)`.
    pub value: Tensor,
    /// Entropy of the policy.
    pub entropy: Tensor,
    /// Divergence `KL(old ‖ new)`, mean over states.
    pub kl: Tensor,
    /// Probability ratio `r` of each sample, shape (rows).
    pub ratio: Tensor,
}

impl Loss {
    /// Computes the loss over the samples of a minibatch.
    ///
    /// # Errors
    /// Candle fails, for example because slices of the batch have the wrong length.
    pub fn new(networks: &CandleNetworks, minibatch: &Minibatch<'_>) -> Result<Self> {
        let Minibatch { batch, settings, rows, .. } = *minibatch;
        let of_batch = |values: &[f32]| rows_of(values, batch.returns.len(), rows);
        let actions = of_batch(batch.actions)?;
        let old_means = of_batch(batch.means)?;
        let old_log_std = Tensor::from_iter(batch.log_std.iter().map(|&x| f64::from(x)), &Device::Cpu)?;
        let old_log_probs = of_batch(batch.log_probs)?.squeeze(1)?;
        let advantages = Tensor::from_iter(rows.iter().map(|&row| minibatch.advantage(row as usize)), &Device::Cpu)?;
        let returns = of_batch(batch.returns)?.squeeze(1)?;

        let (means, log_std, values) =
            networks.forward(&of_batch(batch.observations)?, &of_batch(batch.value_inputs())?)?;

        let ratio = (log_prob(&means, &log_std, &actions)? - old_log_probs)?.exp()?;
        let clipped = ratio.clamp(1.0 - settings.clip_range, 1.0 + settings.clip_range)?;
        let surrogate = (&advantages * &ratio)?.minimum(&(&advantages * clipped)?)?;

        let policy = surrogate.mean_all()?.neg()?;
        let value = (values - returns)?.sqr()?.mean_all()?;
        let entropy = (&log_std + 0.5 * (1.0 + LOG_TWO_PI))?.sum_all()?;
        let kl = kl(&old_means, &old_log_std, &means, &log_std)?;
        let total = ((&policy + (&value * settings.value_coefficient)?)? - (&entropy * settings.entropy_coefficient)?)?;
        Ok(Self { total, policy, value, entropy, kl, ratio })
    }
}

/// The constant `ln 2π`.
const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;

/// Gathers `rows` of values of shape (samples, any).
fn rows_of(values: &[f32], samples: usize, rows: &[u32]) -> Result<Tensor> {
    let width = values.len() / samples;
    let picked = rows.iter().flat_map(|&row| &values[row as usize * width..][..width]);
    Tensor::from_iter(picked.map(|&x| f64::from(x)), &Device::Cpu)?.reshape((rows.len(), width))
}

/// Computes the log-density of a diagonal Gaussian, summed over actions, shape (rows).
fn log_prob(means: &Tensor, log_std: &Tensor, actions: &Tensor) -> Result<Tensor> {
    let z = (actions - means)?.broadcast_div(&log_std.exp()?)?;
    let log_density = ((z.sqr()? * -0.5)?.broadcast_sub(log_std)? - 0.5 * LOG_TWO_PI)?;
    log_density.sum(D::Minus1)
}

/// Computes `KL(old ‖ new)`, summed over actions, mean over rows.
fn kl(old_means: &Tensor, old_log_std: &Tensor, means: &Tensor, log_std: &Tensor) -> Result<Tensor> {
    let variance = (log_std * 2.0)?.exp()?;
    let old_variance = (old_log_std * 2.0)?.exp()?;
    let quadratic = (old_means - means)?.sqr()?.broadcast_add(&old_variance)?.broadcast_div(&(variance * 2.0)?)?;
    let per_action = (quadratic.broadcast_add(&(log_std - old_log_std)?)? - 0.5)?;
    per_action.sum(D::Minus1)?.mean_all()
}

#[cfg(test)]
mod tests {
    use candle_core::DType;

    use super::*;
    use crate::config::Ppo;
    use crate::network::{ActorCritic, Layer, Mlp};
    use crate::ppo::Batch;
    use crate::ppo::loss::tests::settings;
    use crate::ranks::Alone;

    /// Returns the loss of three samples.
    fn loss(settings: &Ppo) -> Loss {
        let linear =
            |weight: &[f32], bias: &[f32]| Mlp { layers: vec![Layer { weight: weight.into(), bias: bias.into() }] };
        let network = ActorCritic {
            policy: linear(&[1.0, -0.5, 0.25, 0.75], &[0.1, -0.2]),
            value: linear(&[0.5, 1.0], &[-0.25]),
            log_std: vec![-0.5, 0.375],
        };
        let batch = Batch {
            observations: &[0.5, -1.0, 1.0, 2.0, -0.5, 0.25],
            critic_observations: &[],
            actions: &[1.0, 0.0, 0.5, 3.0, -1.0, 0.5],
            means: &[1.0, -1.0, 0.25, 1.75, -0.5, 0.0],
            log_std: &[-0.625, 0.25],
            log_probs: &[-1.7661424, -2.0458024, -1.9749863],
            advantages: &[1.0, -2.0, 0.5],
            returns: &[0.5, 2.0, -1.0],
        };
        let networks = CandleNetworks::new(&network, DType::F64).unwrap();
        let orders = [vec![0, 1, 2]];
        Loss::new(&networks, &Minibatch::all(&batch, settings, &orders, &Alone)[0]).unwrap()
    }

    /* The expected numbers:
    import numpy as np
    x = np.array([[.5, -1], [1, 2], [-.5, .25]])
    W, b, w, c = np.array([[1, -.5], [.25, .75]]), np.array([.1, -.2]), np.array([.5, 1]), -.25
    a = np.array([[1, 0], [.5, 3], [-1, .5]])
    m0, s0 = np.array([[1, -1], [.25, 1.75], [-.5, 0]]), np.array([-.625, .25])
    s, A, R = np.array([-.5, .375]), np.array([1, -2, .5]), np.array([.5, 2, -1])
    def log_prob(m, s): return np.sum(-.5*((a - m)/np.exp(s))**2 - s - .5*np.log(2*np.pi), 1)
    m, V = x@W.T + b, x@w + c
    A = (A - A.mean())/(A.std(ddof=1) + 1e-8)
    r = np.exp(log_prob(m, s) - log_prob(m0, s0))                 # .886, .683, .869; A < 0 in the second
    policy = -np.minimum(A*r, A*np.clip(r, .8, 1.2)).mean()
    value, entropy = ((V - R)**2).mean(), np.sum(.5 + .5*np.log(2*np.pi) + s)
    kl = np.mean(np.sum(s - s0 + (np.exp(2*s0) + (m0 - m)**2)/(2*np.exp(2*s)) - .5, 1))
    print(log_prob(m0, s0), policy, value, entropy, kl, policy + .5*value - .01*entropy) */
    #[test]
    fn loss_equals_that_of_numpy() {
        let loss = loss(&settings());
        for (name, actual, expected) in [
            ("policy", loss.policy, -0.030324988),
            ("value", loss.value, 0.958333333),
            ("entropy", loss.entropy, 2.712877066),
            ("KL", loss.kl, 0.050856559),
            ("total", loss.total, 0.421712908),
        ] {
            let actual: f64 = actual.to_scalar().unwrap();
            assert!((actual - expected).abs() < 1e-7, "{name}: {actual}, not {expected}");
        }
    }
}

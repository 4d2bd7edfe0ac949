/*!
PPO's loss written plainly in candle, with gradients by automatic differentiation.

This is what the fused [`Learner`](super::Learner) computes, in the order of the textbook: start reading here. It is
about five times slower and serves as the truth that the fused gradients are tested against, in f32 or f64.

Schulman et al., "Proximal Policy Optimization Algorithms", eq. 7 and 9, as implemented by Stable-Baselines3.
*/

use candle_core::{D, DType, Device, Result, Tensor, Var};
use candle_nn::{Linear, Module};

use super::{ActorCritic, Batch, Hyperparameters, Mlp};

/// Differentiable copy of an [`ActorCritic`].
pub struct Reference {
    policy: Vec<Linear>,
    value: Vec<Linear>,
    log_std: Tensor,
    /// In the order of [`ActorCritic::tensors`].
    variables: Vec<(String, Var)>,
    dtype: DType,
}

/// Terms of the loss over a minibatch, and what is watched beside them; all scalars.
pub struct Loss {
    /// `policy + value_coefficient · value − entropy_coefficient · entropy`
    pub total: Tensor,
    /// `−mean(min(A·r, A·clip(r, 1 − c, 1 + c)))`
    pub policy: Tensor,
    /// `mean((V − R)²)`
    pub value: Tensor,
    /// Entropy of the policy.
    pub entropy: Tensor,
    /// `KL(old ‖ new)`, mean over states.
    pub kl: Tensor,
}

impl Reference {
    /// Copies the weights, as `dtype`.
    ///
    /// # Errors
    /// Only candle's.
    pub fn new(network: &ActorCritic, dtype: DType) -> Result<Self> {
        let variable = |(name, shape, values): (String, Vec<usize>, &[f32])| {
            let tensor = Tensor::from_slice(values, shape, &Device::Cpu)?.to_dtype(dtype)?;
            Ok((name, Var::from_tensor(&tensor)?))
        };
        let variables: Vec<(String, Var)> = network.tensors().into_iter().map(variable).collect::<Result<_>>()?;
        let mut tensors = variables.iter().map(|(_, variable)| variable.as_tensor().clone());
        let mut mlp = |mlp: &Mlp| -> Vec<Linear> {
            let pairs = mlp.layers.iter().filter_map(|_| tensors.next().zip(tensors.next()));
            pairs.map(|(weight, bias)| Linear::new(weight, Some(bias))).collect()
        };
        let (policy, value) = (mlp(&network.policy), mlp(&network.value));
        let log_std = tensors.next().ok_or_else(|| candle_core::Error::Msg("no log_std".into()))?;
        Ok(Self { policy, value, log_std, variables, dtype })
    }

    /// Trainable tensors in the order of [`ActorCritic::tensors`].
    pub fn variables(&self) -> &[(String, Var)] {
        &self.variables
    }

    /// PPO's loss over the samples `rows` of `batch`.
    ///
    /// # Errors
    /// When a row is not in the batch, or slices of the batch do not fit.
    pub fn loss(&self, batch: &Batch<'_>, rows: &[u32], settings: &Hyperparameters) -> Result<Loss> {
        let indices = Tensor::from_slice(rows, rows.len(), &Device::Cpu)?;
        let select = |values: &[f32]| -> Result<Tensor> {
            let samples = batch.returns.len();
            let all = Tensor::from_slice(values, (samples, values.len() / samples), &Device::Cpu)?;
            all.index_select(&indices, 0)?.to_dtype(self.dtype)
        };
        let observations = select(batch.observations)?;
        let actions = select(batch.actions)?;
        let old_means = select(batch.means)?;
        let old_log_probs = select(batch.log_probs)?.squeeze(1)?;
        let advantages = normalised(&select(batch.advantages)?.squeeze(1)?)?;
        let returns = select(batch.returns)?.squeeze(1)?;
        let old_log_std = Tensor::from_slice(batch.log_std, batch.log_std.len(), &Device::Cpu)?.to_dtype(self.dtype)?;

        let means = forward(&self.policy, &observations)?;
        let values = forward(&self.value, &observations)?.squeeze(1)?;

        let ratio = (log_prob(&means, &self.log_std, &actions)? - old_log_probs)?.exp()?;
        let clipped = ratio.clamp(1.0 - settings.clip_range, 1.0 + settings.clip_range)?;
        let surrogate = (&advantages * ratio)?.minimum(&(&advantages * clipped)?)?;

        let policy = surrogate.mean_all()?.neg()?;
        let value = (values - returns)?.sqr()?.mean_all()?;
        let entropy = (&self.log_std + 0.5 * (1.0 + LOG_TWO_PI))?.sum_all()?;
        let kl = kl(&old_means, &old_log_std, &means, &self.log_std)?;
        let total = ((&policy + (&value * settings.value_coefficient)?)? - (&entropy * settings.entropy_coefficient)?)?;
        Ok(Loss { total, policy, value, entropy, kl })
    }

    /// Gradient of `loss`, in the order of [`ActorCritic::tensors`].
    ///
    /// # Errors
    /// Only candle's.
    pub fn gradient(&self, loss: &Tensor) -> Result<Vec<Tensor>> {
        let gradients = loss.backward()?;
        self.variables
            .iter()
            .map(|(_, variable)| gradients.get(variable).cloned().map_or_else(|| variable.zeros_like(), Ok))
            .collect()
    }
}

/// `ln 2π`
const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;

/// `(A − mean) / (std + 1e-8)`, with the unbiased standard deviation.
fn normalised(advantages: &Tensor) -> Result<Tensor> {
    let centred = advantages.broadcast_sub(&advantages.mean_all()?)?;
    let variance = (centred.sqr()?.sum_all()? / (advantages.elem_count() as f64 - 1.0))?;
    centred.broadcast_div(&(variance.sqrt()? + 1e-8)?)
}

fn forward(layers: &[Linear], observations: &Tensor) -> Result<Tensor> {
    let mut x = observations.clone();
    for (i, layer) in layers.iter().enumerate() {
        x = layer.forward(&x)?;
        if i + 1 < layers.len() {
            x = x.elu(1.0)?;
        }
    }
    Ok(x)
}

/// Log-density of a diagonal Gaussian, summed over actions; shape (rows).
fn log_prob(means: &Tensor, log_std: &Tensor, actions: &Tensor) -> Result<Tensor> {
    let z = (actions - means)?.broadcast_div(&log_std.exp()?)?;
    let log_density = ((z.sqr()? * -0.5)?.broadcast_sub(log_std)? - 0.5 * LOG_TWO_PI)?;
    log_density.sum(D::Minus1)
}

/// `KL(old ‖ new)` summed over actions, mean over rows.
fn kl(old_means: &Tensor, old_log_std: &Tensor, means: &Tensor, log_std: &Tensor) -> Result<Tensor> {
    let variance = (log_std * 2.0)?.exp()?;
    let old_variance = (old_log_std * 2.0)?.exp()?;
    let quadratic = (old_means - means)?.sqr()?.broadcast_add(&old_variance)?.broadcast_div(&(variance * 2.0)?)?;
    let per_action = (quadratic.broadcast_add(&(log_std - old_log_std)?)? - 0.5)?;
    per_action.sum(D::Minus1)?.mean_all()
}

#[cfg(test)]
mod tests {
    use super::super::Layer;
    use super::super::loss::tests::SETTINGS;
    use super::*;

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
        let linear =
            |weight: &[f32], bias: &[f32]| Mlp { layers: vec![Layer { weight: weight.into(), bias: bias.into() }] };
        let network = ActorCritic {
            policy: linear(&[1.0, -0.5, 0.25, 0.75], &[0.1, -0.2]),
            value: linear(&[0.5, 1.0], &[-0.25]),
            log_std: vec![-0.5, 0.375],
        };
        let batch = Batch {
            observations: &[0.5, -1.0, 1.0, 2.0, -0.5, 0.25],
            actions: &[1.0, 0.0, 0.5, 3.0, -1.0, 0.5],
            means: &[1.0, -1.0, 0.25, 1.75, -0.5, 0.0],
            log_std: &[-0.625, 0.25],
            log_probs: &[-1.7661424, -2.0458024, -1.9749863],
            advantages: &[1.0, -2.0, 0.5],
            returns: &[0.5, 2.0, -1.0],
        };
        let reference = Reference::new(&network, DType::F64).unwrap();
        let loss = reference.loss(&batch, &[0, 1, 2], &SETTINGS).unwrap();
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

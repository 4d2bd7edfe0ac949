/*! Weights of the policy and the value function as plain numbers.

Everything else (both learners, inference, checkpoints, ONNX) reads and writes this form.
*/

use std::collections::BTreeMap;

use candle_core::Tensor;
use candle_nn::{Linear, Module};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// The reason why tensors are not the weights of a network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NetworkError {
    #[error("there is no tensor `{0}`")]
    Missing(String),
    #[error("tensor `{name}` should have shape {expected:?}, but has shape {found:?} and {elements} elements")]
    Shape { name: String, expected: Vec<usize>, found: Vec<usize>, elements: usize },
    #[error("tensor `{0}` belongs to no layer of the policy or the value function")]
    Unknown(String),
}

/// A linear layer, `y = W·x + b`.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Weights `W`, shape (outputs, inputs), row-major as in PyTorch.
    pub weight: Vec<f32>,
    /// Biases `b`, shape (outputs).
    pub bias: Vec<f32>,
}

impl Layer {
    /// Creates a layer of zeros.
    pub fn zeros(inputs: usize, outputs: usize) -> Self {
        Self { weight: vec![0.0; inputs * outputs], bias: vec![0.0; outputs] }
    }

    /// Creates weights with orthonormal rows or columns, whichever are fewer, times `gain`, and biases of zero.
    pub fn orthogonal(inputs: usize, outputs: usize, gain: f64, rng: &mut impl Rng) -> Self {
        let vectors = orthonormal_vectors(inputs.min(outputs), inputs.max(outputs), rng);
        let mut layer = Self::zeros(inputs, outputs);
        for (i, weight) in layer.weight.iter_mut().enumerate() {
            let (output, input) = (i / inputs, i % inputs);
            let value = if outputs < inputs { vectors[output][input] } else { vectors[input][output] };
            *weight = (gain * value) as f32;
        }
        layer
    }

    methods! {
        /// Returns the number of inputs.
        fn inputs(&self) -> usize = self.weight.len() / self.bias.len();
        /// Returns the number of outputs.
        fn outputs(&self) -> usize = self.bias.len();
    }
}

/// A multilayer perceptron: ELU (α = 1) after each layer but the last.
#[derive(Debug, Clone, PartialEq)]
pub struct Mlp {
    /// The layers from input to output; never empty.
    pub layers: Vec<Layer>,
}

impl Mlp {
    /// Creates layers between these widths: orthogonal weights with gain √2 except in the last layer; no biases.
    pub fn orthogonal(widths: &[usize], last_gain: f64, rng: &mut impl Rng) -> Self {
        let gain = |layer: usize| if layer + 2 == widths.len() { last_gain } else { 2.0_f64.sqrt() };
        let layer = |(k, ends): (usize, &[usize])| Layer::orthogonal(ends[0], ends[1], gain(k), rng);
        Mlp { layers: widths.windows(2).enumerate().map(layer).collect() }
    }

    methods! {
        /// Returns the number of inputs.
        fn inputs(&self) -> usize = self.layers.first().map_or(0, Layer::inputs);
        /// Returns the number of outputs.
        fn outputs(&self) -> usize = self.layers.last().map_or(0, Layer::outputs);
    }

    /// Returns names, shapes and values in order: `0.weight`, `0.bias`, …, each name after `prefix`.
    pub fn tensors(&self, prefix: &str) -> Vec<(String, Vec<usize>, &[f32])> {
        let mut tensors = Vec::new();
        for (k, layer) in self.layers.iter().enumerate() {
            let (inputs, outputs) = (layer.inputs(), layer.outputs());
            tensors.push((format!("{prefix}{k}.weight"), vec![outputs, inputs], layer.weight.as_slice()));
            tensors.push((format!("{prefix}{k}.bias"), vec![outputs], layer.bias.as_slice()));
        }
        tensors
    }

    /// Creates a network from the tensors of [`Mlp::tensors`] with an empty prefix, in any order.
    pub(crate) fn from_tensors(
        tensors: impl IntoIterator<Item = (String, Vec<usize>, Vec<f32>)>,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self, NetworkError> {
        take_mlp(&mut by_name(tensors), "", Some(inputs), outputs)
    }
}

/// A Gaussian policy with state-independent standard deviation, and a value function.
#[derive(Debug, Clone, PartialEq)]
pub struct ActorCritic {
    /// Network from observation to mean action.
    pub policy: Mlp,
    /// Network from the critic's observation to value (one output).
    pub value: Mlp,
    /// `ln σ` of each action, shape (actions).
    pub log_std: Vec<f32>,
}

impl ActorCritic {
    /// Initialises as Stable-Baselines3 does: orthogonal weights with gain √2 in hidden layers, 0.01 in the policy's
    /// last and 1 in the value's last layer; biases zero; `ln σ` the same for all actions.
    pub fn orthogonal(observations: usize, hidden: &[usize], actions: usize, log_std: f32, rng: &mut impl Rng) -> Self {
        Self::asymmetric([observations; 2], hidden, actions, log_std, rng)
    }

    /// Initialises like [`ActorCritic::orthogonal`], with the numbers of inputs of the policy and of the value function.
    pub fn asymmetric(
        [policy, value]: [usize; 2],
        hidden: &[usize],
        actions: usize,
        log_std: f32,
        rng: &mut impl Rng,
    ) -> Self {
        let policy = Mlp::orthogonal(&[&[policy], hidden, &[actions]].concat(), 0.01, rng);
        let value = Mlp::orthogonal(&[&[value], hidden, &[1]].concat(), 1.0, rng);
        Self { policy, value, log_std: vec![log_std; actions] }
    }

    /// Returns zeros with the shapes of `self`.
    pub fn zeros_like(&self) -> Self {
        let zeros = |mlp: &Mlp| Mlp {
            layers: mlp.layers.iter().map(|layer| Layer::zeros(layer.inputs(), layer.outputs())).collect(),
        };
        Self { policy: zeros(&self.policy), value: zeros(&self.value), log_std: vec![0.0; self.log_std.len()] }
    }

    /// Returns names, shapes and values in a fixed order: `policy.0.weight`, `policy.0.bias`, …, `value.0.weight`, …,
    /// `log_std`.
    pub fn tensors(&self) -> Vec<(String, Vec<usize>, &[f32])> {
        let mut tensors = [self.policy.tensors("policy."), self.value.tensors("value.")].concat();
        tensors.push(("log_std".to_owned(), vec![self.log_std.len()], self.log_std.as_slice()));
        tensors
    }

    /// Creates the networks from the tensors of [`Self::tensors`], in any order.
    pub(crate) fn from_tensors(
        tensors: impl IntoIterator<Item = (String, Vec<usize>, Vec<f32>)>,
    ) -> Result<Self, NetworkError> {
        let mut tensors = by_name(tensors);
        let log_std = take(&mut tensors, "log_std", &[None])?;
        let policy = take_mlp(&mut tensors, "policy.", None, log_std.len())?;
        let value = take_mlp(&mut tensors, "value.", None, 1)?;
        match tensors.into_keys().next() {
            Some(name) => Err(NetworkError::Unknown(name)),
            None => Ok(Self { policy, value, log_std }),
        }
    }
}

type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

fn by_name(tensors: impl IntoIterator<Item = (String, Vec<usize>, Vec<f32>)>) -> Tensors {
    tensors.into_iter().map(|(name, shape, values)| (name, (shape, values))).collect()
}

/// Takes the values of a tensor whose shape agrees with the sizes that are known.
fn take(tensors: &mut Tensors, name: &str, known: &[Option<usize>]) -> Result<Vec<f32>, NetworkError> {
    let (found, values) = tensors.remove(name).ok_or_else(|| NetworkError::Missing(name.to_owned()))?;
    let size = |(k, known): (usize, &Option<usize>)| known.or(found.get(k).copied()).unwrap_or(0);
    let expected: Vec<usize> = known.iter().enumerate().map(size).collect();
    let elements = values.len();
    if expected == found && expected.iter().product::<usize>() == elements && elements > 0 {
        return Ok(values);
    }
    Err(NetworkError::Shape { name: name.to_owned(), expected, found, elements })
}

fn take_mlp(tensors: &mut Tensors, prefix: &str, inputs: Option<usize>, outputs: usize) -> Result<Mlp, NetworkError> {
    let mut layers: Vec<Layer> = Vec::new();
    loop {
        let of = |k: usize, part: &str| format!("{prefix}{k}.{part}");
        let k = layers.len();
        let last = !tensors.contains_key(&of(k + 1, "weight"));
        let bias = take(tensors, &of(k, "bias"), &[last.then_some(outputs)])?;
        let inputs = layers.last().map(Layer::outputs).or(inputs);
        let weight = take(tensors, &of(k, "weight"), &[Some(bias.len()), inputs])?;
        layers.push(Layer { weight, bias });
        if last {
            return Ok(Mlp { layers });
        }
    }
}

/// Draws `count` orthonormal vectors of `length` ≥ `count`, uniformly: Gram-Schmidt, run twice for accuracy, on normal
/// deviates. This is the Q of their QR decomposition with a positive diagonal of R.
fn orthonormal_vectors(count: usize, length: usize, rng: &mut impl Rng) -> Vec<Vec<f64>> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut vectors: Vec<Vec<f64>> = Vec::with_capacity(count);
    for _ in 0..count {
        let mut vector: Vec<f64> = (0..length).map(|_| StandardNormal.sample(rng)).collect();
        for _ in 0..2 {
            for other in &vectors {
                let projection = dot(&vector, other);
                vector.iter_mut().zip(other).for_each(|(x, other)| *x -= projection * other);
            }
        }
        let norm = dot(&vector, &vector).sqrt();
        vector.iter_mut().for_each(|x| *x /= norm);
        vectors.push(vector);
    }
    vectors
}

/// Evaluates candle's layers as [`PackedMlp`](super::PackedMlp) does plain ones.
pub fn forward(layers: &[Linear], observations: &Tensor) -> candle_core::Result<Tensor> {
    let mut x = observations.clone();
    for (i, layer) in layers.iter().enumerate() {
        x = layer.forward(&x)?;
        if i + 1 < layers.len() {
            x = x.elu(1.0)?;
        }
    }
    Ok(x)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn network() -> ActorCritic {
        ActorCritic::orthogonal(11, &[20, 7], 3, -1.0, &mut ChaCha8Rng::seed_from_u64(1))
    }

    type OwnedTensors = Vec<(String, Vec<usize>, Vec<f32>)>;

    fn owned(network: &ActorCritic) -> OwnedTensors {
        network.tensors().into_iter().map(|(name, shape, values)| (name, shape, values.to_vec())).collect()
    }

    fn largest_deviation_from_orthogonality(layer: &Layer, gain: f32) -> f32 {
        let (inputs, outputs) = (layer.inputs(), layer.outputs());
        let at = |vector: usize, i: usize| match outputs < inputs {
            true => layer.weight[vector * inputs + i],
            false => layer.weight[i * inputs + vector],
        };
        let count = inputs.min(outputs);
        let pairs = (0..count).flat_map(|a| (0..=a).map(move |b| (a, b)));
        pairs.fold(0.0, |worst: f32, (a, b)| {
            let dot: f32 = (0..inputs.max(outputs)).map(|i| at(a, i) * at(b, i)).sum();
            worst.max((dot / gain.powi(2) - if a == b { 1.0 } else { 0.0 }).abs())
        })
    }

    #[test]
    fn initial_weights_are_orthogonal_with_the_gains_of_stable_baselines() {
        let network = network();
        for (mlp, last_gain) in [(&network.policy, 0.01), (&network.value, 1.0)] {
            for (i, layer) in mlp.layers.iter().enumerate() {
                let gain = if i == 2 { last_gain } else { 2.0_f32.sqrt() };
                assert!(largest_deviation_from_orthogonality(layer, gain) < 1e-5, "layer {i}");
                assert!(layer.bias.iter().all(|&bias| bias == 0.0));
            }
        }
        assert_eq!(network.log_std, [-1.0; 3]);
    }

    #[test]
    fn tensors_have_a_fixed_order() {
        let network = network();
        let names: Vec<_> = network.tensors().into_iter().map(|(name, ..)| name).collect();
        assert_eq!(names[..3], ["policy.0.weight", "policy.0.bias", "policy.1.weight"]);
        assert_eq!(names[11..], ["value.2.bias", "log_std"]);
        assert_eq!(network.tensors()[2].1, [7, 20]);
    }

    #[test]
    fn tensors_in_any_order_make_the_same_network() {
        let network = network();
        let mut tensors = owned(&network);
        tensors.reverse();
        assert_eq!(ActorCritic::from_tensors(tensors).as_ref(), Ok(&network));
    }

    #[test]
    fn unfit_tensors_are_refused_by_name() {
        let error = |change: fn(&mut OwnedTensors)| {
            let mut tensors = owned(&network());
            change(&mut tensors);
            ActorCritic::from_tensors(tensors).unwrap_err().to_string()
        };
        assert_eq!(error(|t| drop(t.remove(1))), "there is no tensor `policy.0.bias`");
        let found = error(|t| t[2].1 = vec![20, 7]);
        assert_eq!(found, "tensor `policy.1.weight` should have shape [7, 20], but has shape [20, 7] and 140 elements");
        let found = error(|t| t.push(("policy.5.bias".into(), vec![1], vec![0.0])));
        assert_eq!(found, "tensor `policy.5.bias` belongs to no layer of the policy or the value function");
    }
}

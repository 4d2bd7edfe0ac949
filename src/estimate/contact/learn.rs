//! Supervised training of the contact network with candle: cross-entropy loss, Adam, learning rate falling to zero.

use candle_core::{Device, Result, Tensor, Var};
use candle_nn::{AdamW, Linear, Optimizer, ParamsAdamW};
use rand::seq::SliceRandom;

use crate::network::{Layer, Mlp, forward};
use crate::util::random::{Purpose, stream};

/// Training samples: inputs with their labels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ContactSamples {
    /// Inputs in physical units, shape (n, inputs), row-major.
    pub inputs: Vec<f32>,
    /// Labels, shape (n, outputs), row-major: 1 for contact, 0 for none.
    pub labels: Vec<f32>,
}

/// Hyperparameters of the training.
#[derive(Debug, Clone, PartialEq)]
pub struct Learning {
    /// Widths of the hidden layers.
    pub hidden: Vec<usize>,
    /// Number of epochs.
    pub epochs: usize,
    /// Number of samples in a minibatch.
    pub batch: usize,
    /// Initial learning rate of Adam; it falls to zero along half a cosine.
    pub rate: f64,
    /// Seed of initial weights and of the order of samples.
    pub seed: u64,
}

impl Default for Learning {
    fn default() -> Self {
        Learning { hidden: vec![128, 64], epochs: 12, batch: 512, rate: 2e-3, seed: 0 }
    }
}

/// A trained network and the normaliser of its inputs: `(x − offset) · scale`.
#[derive(Debug, Clone, PartialEq)]
pub struct Learnt {
    /// The network from normalised inputs to a logit for each output.
    pub mlp: Mlp,
    /// Mean of each input.
    pub offset: Vec<f32>,
    /// Inverse standard deviation of each input; 1 for an input that never changes.
    pub scale: Vec<f32>,
}

/// Trains on samples with rows of `inputs` numbers and `outputs` labels; `progress` receives each epoch and its mean
/// loss. On one machine, the same samples and seed give the same bits.
///
/// # Errors
/// Candle fails, for example because the samples do not have these shapes.
pub fn learn(
    samples: &ContactSamples,
    [inputs, outputs]: [usize; 2],
    learning: &Learning,
    mut progress: impl FnMut(usize, f64),
) -> Result<Learnt> {
    let count = samples.labels.len() / outputs.max(1);
    let (offset, scale) = moments(&samples.inputs, inputs);
    let device = Device::Cpu;
    let row = |values: &[f32]| Tensor::from_slice(values, (1, inputs), &device);
    let seen = Tensor::from_slice(&samples.inputs, (count, inputs), &device)?;
    let seen = seen.broadcast_sub(&row(&offset)?)?.broadcast_mul(&row(&scale)?)?;
    let labels = Tensor::from_slice(&samples.labels, (count, outputs), &device)?;

    let (layers, variables) = network(inputs, outputs, learning)?;
    let mut adam = AdamW::new(variables, ParamsAdamW { lr: learning.rate, weight_decay: 0.0, ..Default::default() })?;
    let mut order: Vec<u32> = (0..count as u32).collect();
    let batches = count.div_ceil(learning.batch);
    for epoch in 0..learning.epochs {
        order.shuffle(&mut stream(learning.seed, Purpose::Shuffle, epoch as u64, 0));
        let mut sum = 0.0;
        for (index, rows) in order.chunks(learning.batch).enumerate() {
            let done = (epoch * batches + index) as f64 / (learning.epochs * batches) as f64;
            adam.set_learning_rate(0.5 * learning.rate * (1.0 + (std::f64::consts::PI * done).cos()));
            let rows = Tensor::from_slice(rows, rows.len(), &device)?;
            let logits = forward(&layers, &seen.index_select(&rows, 0)?)?;
            let loss = cross_entropy(&logits, &labels.index_select(&rows, 0)?)?;
            adam.backward_step(&loss)?;
            sum += f64::from(loss.to_scalar::<f32>()?);
        }
        progress(epoch, sum / batches as f64);
    }
    let read = |layer: &Linear| -> Result<Layer> {
        let bias = layer.bias().map_or(Ok(Vec::new()), Tensor::to_vec1)?;
        Ok(Layer { weight: layer.weight().flatten_all()?.to_vec1()?, bias })
    };
    Ok(Learnt { mlp: Mlp { layers: layers.iter().map(read).collect::<Result<_>>()? }, offset, scale })
}

/// Creates orthogonal weights; those of the last layer are small, so that training starts undecided.
fn network(inputs: usize, outputs: usize, learning: &Learning) -> Result<(Vec<Linear>, Vec<Var>)> {
    let mut rng = stream(learning.seed, Purpose::Weights, 0, 0);
    let mlp = Mlp::orthogonal(&[&[inputs], &learning.hidden[..], &[outputs]].concat(), 0.01, &mut rng);
    let (mut layers, mut variables) = (Vec::new(), Vec::new());
    for layer in &mlp.layers {
        let weight = Var::from_slice(&layer.weight, (layer.outputs(), layer.inputs()), &Device::Cpu)?;
        let bias = Var::from_slice(&layer.bias, layer.outputs(), &Device::Cpu)?;
        layers.push(Linear::new(weight.as_tensor().clone(), Some(bias.as_tensor().clone())));
        variables.extend([weight, bias]);
    }
    Ok((layers, variables))
}

/// Computes `mean(max(x, 0) − x y + ln(1 + exp(−|x|)))`; candle's own cross-entropy takes `ln 0` where the network is
/// certain.
fn cross_entropy(logits: &Tensor, labels: &Tensor) -> Result<Tensor> {
    let softened = (logits.abs()?.neg()?.exp()? + 1.0)?.log()?;
    ((logits.relu()? - (logits * labels)?)? + softened)?.mean_all()
}

/// Returns the mean of each column and its inverse standard deviation.
fn moments(values: &[f32], columns: usize) -> (Vec<f32>, Vec<f32>) {
    let count = (values.len() / columns).max(1) as f64;
    let (mut sums, mut squares) = (vec![0.0; columns], vec![0.0; columns]);
    for row in values.chunks_exact(columns) {
        for (column, value) in row.iter().enumerate() {
            sums[column] += f64::from(*value);
            squares[column] += f64::from(*value).powi(2);
        }
    }
    let of = |column: usize| -> (f32, f32) {
        let mean = sums[column] / count;
        let sd = (squares[column] / count - mean * mean).max(0.0).sqrt();
        (mean as f32, if sd > 1e-6 { (1.0 / sd) as f32 } else { 1.0 })
    };
    (0..columns).map(of).unzip()
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use crate::network::{PackedMlp, Scratch};

    /// Draws two numbers of very different size and a third that never changes; labels: the first above 3, an exclusive
    /// or.
    fn separable(count: usize) -> ContactSamples {
        let mut rng = stream(7, Purpose::Episode, 0, 0);
        let mut samples = ContactSamples::default();
        for _ in 0..count {
            let (a, b): (f32, f32) = (rng.random_range(2.0..4.0), rng.random_range(-1e-3..1e-3));
            samples.inputs.extend([a, b, 5.0]);
            samples.labels.extend([a > 3.0, (a > 3.0) != (b > 0.0)].map(|is| f32::from(u8::from(is))));
        }
        samples
    }

    fn small() -> Learning {
        Learning { hidden: vec![16], epochs: 30, batch: 64, rate: 2e-2, seed: 1 }
    }

    #[test]
    fn a_separable_problem_is_learnt_and_the_loss_falls() {
        let samples = separable(1000);
        let mut losses = Vec::new();
        let learnt = learn(&samples, [3, 2], &small(), |_, loss| losses.push(loss)).unwrap();
        assert!(losses[0] > 0.3 && losses[29] < 0.1, "{losses:?}");
        let (packed, mut scratch) = (PackedMlp::new(&learnt.mlp), Scratch::default());
        let fresh = separable(2000);
        let mut right = 0;
        for (row, labels) in fresh.inputs.chunks(3).zip(fresh.labels.chunks(2)).skip(1000) {
            let seen: Vec<f32> = (0..3).map(|k| (row[k] - learnt.offset[k]) * learnt.scale[k]).collect();
            let mut logits = [0.0; 2];
            packed.forward(1, &seen, &mut logits, &mut scratch);
            right += (0..2).filter(|k| (logits[*k] > 0.0) == (labels[*k] > 0.5)).count();
        }
        assert!(right > 1900, "{right} of 2000");
    }

    #[test]
    fn the_same_seed_learns_the_same_bits_and_another_seed_others() {
        let samples = separable(200);
        let run = |seed| learn(&samples, [3, 2], &Learning { epochs: 2, seed, ..small() }, |_, _| {}).unwrap();
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
    }

    #[test]
    fn cross_entropy_is_finite_where_the_network_is_sure_and_wrong() {
        let logits = Tensor::from_slice(&[0.0_f32, 200.0, -200.0], 3, &Device::Cpu).unwrap();
        let labels = Tensor::from_slice(&[1.0_f32, 0.0, 1.0], 3, &Device::Cpu).unwrap();
        let loss = cross_entropy(&logits, &labels).unwrap().to_scalar::<f32>().unwrap();
        // (ln 2 + 200 + 200) / 3
        assert!((loss - (2.0_f32.ln() + 400.0) / 3.0).abs() < 1e-3, "{loss}");
    }

    #[test]
    fn moments_of_a_column_by_hand() {
        // 1, 3, 5: mean 3, variance (4 + 0 + 4) / 3.
        let (offset, scale) = moments(&[1.0, 7.0, 3.0, 7.0, 5.0, 7.0], 2);
        assert_eq!((offset[0], offset[1], scale[1]), (3.0, 7.0, 1.0));
        assert!((scale[0] - (3.0_f32 / 8.0).sqrt()).abs() < 1e-6);
    }
}

/*!
Forward and backward pass of one network over one block of rows of a minibatch.
*/

use std::sync::RwLockReadGuard;

use pulp::Arch;

use super::kernels::{Backward, Buffer, PANEL, Stretch, row_stride};
use super::loss::Surrogate;
use super::network::Mlp;
use super::optimizer::Parameters;
use super::packed::{BLOCK, forward_layer, panel_outputs};
use super::{Batch, DiagonalGaussian, Hyperparameters, KlDivergence};

/// A layer's panel: up to 32 outputs.
#[derive(Debug)]
pub struct Panel {
    /// Shape (inputs + 1, padded outputs of the panel).
    pub parameters: Parameters,
    /// The weights the other way round, for the backward product; shape (outputs of the panel, inputs). Empty in the
    /// first layer, whose input needs no gradient.
    pub transposed: Buffer,
    /// Sum of squares of the gradient.
    pub squares: f64,
}

impl Panel {
    /// Refreshes the transposed weights of a layer with `inputs` inputs.
    pub fn transpose(&mut self, inputs: usize) {
        let width = self.parameters.values.len() / (inputs + 1);
        for (output, row) in self.transposed.chunks_mut(row_stride(inputs)).enumerate() {
            for (x, weights) in row[..inputs].iter_mut().zip(self.parameters.values.chunks(width)) {
                *x = weights[output];
            }
        }
    }
}

/// A layer during one phase: what the kernels need to know, and its panels locked for reading.
pub struct LayerView<'a> {
    pub inputs: usize,
    pub outputs: usize,
    pub panels: Vec<RwLockReadGuard<'a, Panel>>,
}

/// Activations and loss gradients of up to [`BLOCK`] rows in one network.
#[derive(Debug)]
pub struct Block {
    /// Rows in use.
    pub rows: usize,
    /// Input of each layer, then the output of the last; shape (rows, inputs of the layer).
    pub activations: Vec<Buffer>,
    /// Gradient of the loss by each layer's output, ahead of ELU; shape (rows, outputs of the layer).
    pub deltas: Vec<Buffer>,
    /// Contribution to the minibatch.
    pub sums: Sums,
}

/// Sums over rows.
#[derive(Debug, Clone, Default)]
pub struct Sums {
    pub policy_loss: f64,
    pub value_loss: f64,
    pub kl: f64,
    pub clipped: f64,
    /// Gradient of the policy loss by `ln σ`; shape (actions).
    pub log_std_gradient: Vec<f64>,
}

/// What all rows of a minibatch share.
pub struct Minibatch<'a> {
    pub batch: &'a Batch<'a>,
    pub settings: &'a Hyperparameters,
    pub rows: &'a [u32],
    pub advantage_mean: f64,
    pub advantage_scale: f64,
}

impl Block {
    /// Room for one block of `mlp`.
    pub fn new(mlp: &Mlp) -> Self {
        let room = |columns: usize| Buffer::zeros(BLOCK * row_stride(columns));
        let deltas: Vec<Buffer> = mlp.layers.iter().map(|layer| room(layer.outputs())).collect();
        let mut activations = vec![room(mlp.inputs())];
        activations.extend(mlp.layers.iter().map(|layer| room(layer.outputs())));
        Self {
            rows: 0,
            activations,
            deltas,
            sums: Sums::default(),
        }
    }

    /// Gathers the observations of `rows` and evaluates the network.
    pub fn forward(&mut self, arch: Arch, layers: &[LayerView<'_>], observations: &[f32], rows: &[u32]) {
        self.rows = rows.len();
        let size = layers[0].inputs;
        for (x, &row) in self.activations[0].chunks_mut(row_stride(size)).zip(rows) {
            x[..size].copy_from_slice(&observations[row as usize * size..][..size]);
        }
        for (i, layer) in layers.iter().enumerate() {
            let (before, after) = self.activations.split_at_mut(i + 1);
            let panels = layer.panels.iter().map(|panel| &*panel.parameters.values);
            let elu = i + 1 < layers.len();
            let x_stride = row_stride(layer.inputs);
            forward_layer(
                arch,
                self.rows,
                &before[i],
                x_stride,
                panels,
                layer.outputs,
                elu,
                &mut after[0],
            );
        }
    }

    /// The policy loss and its gradient by the means and `ln σ`.
    pub fn policy_loss(
        &mut self,
        minibatch: &Minibatch<'_>,
        new: &DiagonalGaussian,
        kl: &KlDivergence<'_>,
        rows: &[u32],
    ) {
        let Minibatch {
            batch,
            settings,
            advantage_mean,
            advantage_scale,
            ..
        } = *minibatch;
        let actions = batch.log_std.len();
        let stride = row_stride(actions);
        let per_sample = 1.0 / minibatch.rows.len() as f64;
        let mut sums = Sums {
            log_std_gradient: vec![0.0; actions],
            ..Sums::default()
        };
        let (Some(means), Some(deltas)) = (self.activations.last(), self.deltas.last_mut()) else {
            return;
        };

        for ((mean, delta), &row) in means.chunks(stride).zip(deltas.chunks_mut(stride)).zip(rows) {
            let row = row as usize;
            let mean = &mean[..actions];
            let action = &batch.actions[row * actions..][..actions];
            let ratio = (new.log_prob(mean, action) - f64::from(batch.log_probs[row])).exp();
            let advantage = (f64::from(batch.advantages[row]) - advantage_mean) * advantage_scale;
            let surrogate = Surrogate::new(advantage, ratio, settings.clip_range);
            sums.policy_loss += surrogate.loss;
            sums.clipped += f64::from(surrogate.clipped);
            sums.kl += kl.at(&batch.means[row * actions..][..actions], mean);

            let slope = surrogate.slope * per_sample;
            for i in 0..actions {
                let z = (f64::from(action[i]) - f64::from(mean[i])) * new.inverse_std()[i];
                delta[i] = (slope * z * new.inverse_std()[i]) as f32;
                sums.log_std_gradient[i] += slope * (z * z - 1.0);
            }
        }
        self.sums = sums;
    }

    /// The value loss and its gradient by the values.
    pub fn value_loss(&mut self, minibatch: &Minibatch<'_>, rows: &[u32]) {
        let stride = row_stride(1);
        let scale = 2.0 * minibatch.settings.value_coefficient / minibatch.rows.len() as f64;
        let mut value_loss = 0.0;
        let (Some(values), Some(deltas)) = (self.activations.last(), self.deltas.last_mut()) else {
            return;
        };
        for ((value, delta), &row) in values.chunks(stride).zip(deltas.chunks_mut(stride)).zip(rows) {
            let error = f64::from(value[0]) - f64::from(minibatch.batch.returns[row as usize]);
            value_loss += error * error;
            delta[0] = (scale * error) as f32;
        }
        self.sums = Sums {
            value_loss,
            ..Sums::default()
        };
    }

    /// Carries the loss gradient from the last layer's output back to the first layer's.
    pub fn backward(&mut self, arch: Arch, layers: &[LayerView<'_>]) {
        for (i, layer) in layers.iter().enumerate().skip(1).rev() {
            let (before, after) = self.deltas.split_at_mut(i);
            let delta = &*after[0];
            let panels: Vec<Stretch<'_>> = layer
                .panels
                .iter()
                .enumerate()
                .map(|(j, panel)| Stretch {
                    depth: panel_outputs(layer.outputs, j),
                    a: &delta[j * PANEL..],
                    b: &panel.transposed,
                })
                .collect();
            arch.dispatch(Backward {
                rows: self.rows,
                panels: &panels,
                delta_stride: row_stride(layer.outputs),
                inputs: layer.inputs,
                x: &self.activations[i],
                delta_x: &mut before[i - 1],
            });
        }
    }
}

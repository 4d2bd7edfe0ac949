/*!
Forward and backward pass of one network over one block of rows of a minibatch.
*/

use std::sync::RwLockReadGuard;

use pulp::Arch;

use super::panel::Panel;
use crate::network::BLOCK;
use crate::network::kernels::{Buffer, Ends, Product, Stretch, padded, row_stride};
use crate::network::{Mlp, panel};
use crate::ppo::loss::{Minibatch, Surrogate};
use crate::ppo::{DiagonalGaussian, KlDivergence};

/// A layer's panels, locked for reading.
pub type Panels<'a, 'b> = &'a [RwLockReadGuard<'b, Panel>];

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
    /// Largest probability ratio, not a sum.
    pub max_ratio: f64,
    /// Gradient of the policy loss by `ln σ`; shape (actions).
    pub log_std_gradient: Vec<f64>,
}

impl Block {
    /// Room for one block of `mlp`.
    pub fn new(mlp: &Mlp) -> Self {
        let room = |columns: usize| Buffer::zeros(BLOCK * row_stride(columns));
        let outputs = || mlp.layers.iter().map(|layer| room(layer.outputs()));
        let activations = std::iter::once(room(mlp.inputs())).chain(outputs()).collect();
        Self { rows: 0, activations, deltas: outputs().collect(), sums: Sums::default() }
    }

    /// Gathers the observations of `rows` and evaluates the network.
    pub fn forward(&mut self, arch: Arch, layers: &[Panels<'_, '_>], observations: &[f32], rows: &[u32]) {
        self.rows = rows.len();
        let size = layers[0][0].inputs;
        for (x, &row) in self.activations[0].chunks_mut(row_stride(size)).zip(rows) {
            x[..size].copy_from_slice(&observations[row as usize * size..][..size]);
        }
        for (i, panels) in layers.iter().enumerate() {
            let (inputs, layer_outputs) = (panels[0].inputs, panels[0].layer_outputs);
            let (before, after) = self.activations.split_at_mut(i + 1);
            let x = (&*before[i], row_stride(inputs));
            let elu = i + 1 < layers.len();
            let panels = panels.iter().map(|panel| &*panel.parameters.values);
            panel::forward(arch, self.rows, x, panels, layer_outputs, elu, &mut after[0]);
        }
    }

    /// The policy loss of `rows` and its gradient by the means and `ln σ`.
    pub fn policy_loss(
        &mut self,
        minibatch: &Minibatch<'_>,
        rows: &[u32],
        new: &DiagonalGaussian,
        kl: &KlDivergence<'_>,
    ) {
        let Minibatch { batch, settings, .. } = *minibatch;
        let actions = batch.log_std.len();
        let stride = row_stride(actions);
        let mut sums = Sums { log_std_gradient: vec![0.0; actions], ..Sums::default() };
        let last = self.deltas.len() - 1;
        let (means, deltas) = (&self.activations[last + 1], &mut self.deltas[last]);

        for ((mean, delta), &row) in means.chunks(stride).zip(deltas.chunks_mut(stride)).zip(rows) {
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

            let slope = surrogate.slope / minibatch.rows.len() as f64;
            for (i, inverse_std) in new.inverse_std().iter().enumerate() {
                let z = (f64::from(action[i]) - f64::from(mean[i])) * inverse_std;
                delta[i] = (slope * z * inverse_std) as f32;
                sums.log_std_gradient[i] += slope * (z * z - 1.0);
            }
        }
        self.sums = sums;
    }

    /// The value loss of `rows` and its gradient by the values.
    pub fn value_loss(&mut self, minibatch: &Minibatch<'_>, rows: &[u32]) {
        let stride = row_stride(1);
        let scale = 2.0 * minibatch.settings.value_coefficient / minibatch.rows.len() as f64;
        let mut value_loss = 0.0;
        let last = self.deltas.len() - 1;
        let (values, deltas) = (&self.activations[last + 1], &mut self.deltas[last]);
        for ((value, delta), &row) in values.chunks(stride).zip(deltas.chunks_mut(stride)).zip(rows) {
            let error = f64::from(value[0]) - f64::from(minibatch.batch.returns[row as usize]);
            value_loss += error * error;
            delta[0] = (scale * error) as f32;
        }
        self.sums = Sums { value_loss, ..Sums::default() };
    }

    /// Carries the loss gradient from the last layer's output back to the first layer's.
    pub fn backward(&mut self, arch: Arch, layers: &[Panels<'_, '_>]) {
        for (i, panels) in layers.iter().enumerate().skip(1).rev() {
            let (inputs, layer_outputs) = (panels[0].inputs, panels[0].layer_outputs);
            let (before, after) = self.deltas.split_at_mut(i);
            let stretches: Vec<_> = panels
                .iter()
                .map(|panel| Stretch { depth: panel.outputs(), a: &after[0][panel.first..], b: &panel.transposed })
                .collect();
            let product = Product {
                rows: self.rows,
                columns: padded(inputs),
                stretches: &stretches,
                a_transposed: false,
                a_stride: row_stride(layer_outputs),
                b_stride: row_stride(inputs),
                ends: Ends::EluSlope { y: &self.activations[i] },
                c: &mut before[i - 1],
                c_stride: row_stride(inputs),
            };
            product.compute(arch);
        }
    }
}

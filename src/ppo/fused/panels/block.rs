/*!
Forward and backward pass of one network over one block of rows of a minibatch.
*/

use std::sync::RwLockReadGuard;

use pulp::Arch;

use super::panel::Panel;
use crate::network::BLOCK;
use crate::network::kernels::{Buffer, Ends, Product, Stretch, padded, row_stride};
use crate::network::{Mlp, panel};
use crate::ppo::fused::losses::Pass;

/// A layer's panels, locked for reading.
pub type LayerPanels<'a, 'b> = &'a [RwLockReadGuard<'b, Panel>];

/// Activations and loss gradients of up to [`BLOCK`] rows in one network.
#[derive(Debug)]
pub struct Block {
    /// Of the network.
    outputs: usize,
    /// Rows in use.
    pub rows: usize,
    /// Input of each layer, then the output of the last; shape (rows, inputs of the layer).
    pub activations: Vec<Buffer>,
    /// Gradient of the loss by each layer's output, ahead of ELU; shape (rows, outputs of the layer).
    pub deltas: Vec<Buffer>,
}

impl Block {
    /// Room for one block of `mlp`.
    pub fn new(mlp: &Mlp) -> Self {
        let room = |columns: usize| Buffer::zeros(BLOCK * row_stride(columns));
        let outputs = || mlp.layers.iter().map(|layer| room(layer.outputs()));
        let activations = std::iter::once(room(mlp.inputs())).chain(outputs()).collect();
        Self { outputs: mlp.outputs(), rows: 0, activations, deltas: outputs().collect() }
    }

    /// Gathers the observations of `rows` and evaluates the network.
    pub fn forward(&mut self, arch: Arch, layers: &[LayerPanels<'_, '_>], observations: &[f32], rows: &[u32]) {
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

    /// Between forward and backward pass.
    pub fn pass(&mut self, network: usize, block: usize) -> Pass<'_> {
        let last = self.deltas.len() - 1;
        Pass {
            network,
            block,
            stride: row_stride(self.outputs),
            outputs: &self.activations[last + 1],
            deltas: &mut self.deltas[last],
        }
    }

    /// Carries the loss gradient from the last layer's output back to the first layer's.
    pub fn backward(&mut self, arch: Arch, layers: &[LayerPanels<'_, '_>]) {
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

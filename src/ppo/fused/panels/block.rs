//! Forward and backward pass of one network over one block of rows of a minibatch.

use pulp::Arch;

use super::slice::{SLICE, Slice};
use crate::network::kernels::{AlignedBuffer, Ends, Matrix, PANEL, Product, Stretch};
use crate::network::{BLOCK, Mlp, panel};
use crate::ppo::fused::LayerPanels;
use crate::ppo::fused::losses::Pass;

/// Activations and loss gradients of up to [`BLOCK`] rows in one network.
#[derive(Debug)]
pub struct PanelBlock {
    /// Number of outputs of the network.
    outputs: usize,
    /// Number of rows in use.
    pub rows: usize,
    /// Input of each layer and the output of the last, shape (rows, inputs of the layer).
    pub activations: Vec<Matrix>,
    /// Gradient of the loss by each layer's output before ELU, shape (rows, outputs of the layer).
    pub deltas: Vec<Matrix>,
    /// Output of the last layer, row by row, for the loss, shape (rows, outputs).
    output: AlignedBuffer,
    output_deltas: AlignedBuffer,
}

impl PanelBlock {
    /// Allocates room for one block of `mlp`.
    pub fn new(mlp: &Mlp) -> Self {
        let room = |columns: usize| Matrix::zeros(BLOCK, columns);
        let (outputs, of_layers) = (mlp.outputs(), || mlp.layers.iter().map(|layer| room(layer.outputs())));
        let activations = std::iter::once(room(mlp.inputs())).chain(of_layers()).collect();
        let [output, output_deltas] = [(); 2].map(|()| AlignedBuffer::zeros(BLOCK * outputs));
        Self { outputs, rows: 0, activations, deltas: of_layers().collect(), output, output_deltas }
    }

    /// Gathers the inputs of `rows` and evaluates the network.
    pub fn forward(&mut self, arch: Arch, layers: &[LayerPanels<'_, '_, Slice>], observations: &[f32], rows: &[u32]) {
        self.rows = rows.len();
        let size = layers[0][0].inputs;
        for (to, &row) in rows.iter().enumerate() {
            self.activations[0].set_row(to, &observations[row as usize * size..][..size]);
        }
        for (i, slices) in layers.iter().enumerate() {
            let (before, after) = self.activations.split_at_mut(i + 1);
            let elu = i + 1 < layers.len();
            let rows = slices.iter().map(|slice| slice.parameters.values.rows());
            let weights = (rows, slices[0].per_panel());
            panel::forward(arch, self.rows, &before[i], weights, slices[0].layer_outputs, elu, &mut after[0]);
        }
    }

    /// Computes the loss between the forward and the backward pass.
    pub fn pass(&mut self, network: usize, block: usize) -> Pass<'_> {
        let last = &self.activations[self.deltas.len()];
        let rows = self.output.chunks_mut(self.outputs).take(self.rows).enumerate();
        rows.for_each(|(row, values)| last.read_row(row, values));
        Pass { network, block, stride: self.outputs, outputs: &self.output, deltas: &mut self.output_deltas }
    }

    /// Propagates the loss gradient from the last layer's output back to the first layer's.
    pub fn backward(&mut self, arch: Arch, layers: &[LayerPanels<'_, '_, Slice>]) {
        let (last, rows) = (layers.len() - 1, self.output_deltas.chunks(self.outputs).take(self.rows).enumerate());
        rows.for_each(|(row, values)| self.deltas[last].set_row(row, values));
        for (i, slices) in layers.iter().enumerate().skip(1).rev() {
            let (before, after) = self.deltas.split_at_mut(i);
            let mut stretches = Vec::new();
            let columns = before[i - 1].panels_mut().zip(self.activations[i].panels()).enumerate();
            for (column, (c, y)) in columns {
                stretches.clear();
                let (slice, column_of_slice) = (column * PANEL / SLICE, column % (SLICE / PANEL));
                let pairs = after[0].panels().zip(slices.iter().skip(slice).step_by(slices[0].per_panel()));
                stretches.extend(pairs.map(|(a, slice)| Stretch { a, b: slice.transposed(column_of_slice) }));
                let (columns, ends) = (slices[0].inputs - column * PANEL, Ends::EluSlope { y });
                let columns = columns.min(PANEL);
                let product = Product { rows: self.rows, columns, stretches: &stretches, a_transposed: false, ends, c };
                product.compute(arch);
            }
        }
    }
}

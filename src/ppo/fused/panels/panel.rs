//! A panel of 32 outputs in training, differentiated and stepped as a unit.

use crate::network::Layer;
use crate::network::kernels::{AlignedBuffer, PANEL, Row};
use crate::network::panel::{pack, panel_outputs};
use crate::ppo::fused::optimizer::AdamParameters;
use crate::ppo::fused::tree::Tree;

/// A panel of 32 outputs in training.
#[derive(Debug)]
pub struct Panel {
    /// Index of the network: 0 for the policy, 1 for the value function.
    pub network: usize,
    /// Index of the layer.
    pub depth: usize,
    /// Number of inputs of the layer.
    pub inputs: usize,
    /// Number of outputs of the layer.
    pub layer_outputs: usize,
    /// Index of the panel's first output in the layer.
    pub first: usize,
    /// Weights and biases: a row for each input, the bias last.
    pub parameters: AdamParameters,
    /// Transposed weights for the backward product: panels of 32 inputs, a row for each output. Empty in the first
    /// layer, whose input needs no gradient.
    transposed: AlignedBuffer,
    /// Partial sums of the shards' gradients.
    pub tree: Tree,
    /// Sum of squares of the gradient.
    pub squares: f64,
}

impl Panel {
    /// Creates the panel that starts at output `first` of a layer, with its moments.
    pub fn new(network: usize, depth: usize, first: usize, [values, first_moment, second_moment]: [&Layer; 3]) -> Self {
        let (inputs, layer_outputs) = (values.inputs(), values.outputs());
        let transposed =
            if depth == 0 { 0 } else { inputs.next_multiple_of(PANEL) * panel_outputs(layer_outputs, first) };
        let mut panel = Self {
            network,
            depth,
            inputs,
            layer_outputs,
            first,
            parameters: AdamParameters::new([values, first_moment, second_moment].map(|layer| pack(layer, first))),
            transposed: AlignedBuffer::zeros(transposed),
            tree: Tree::default(),
            squares: 0.0,
        };
        panel.transpose();
        panel
    }

    /// Returns the number of outputs, without padding.
    pub fn outputs(&self) -> usize {
        panel_outputs(self.layer_outputs, self.first)
    }

    /// Returns the transposed weights of the 32 inputs that start at 32 · `column`.
    pub fn transposed(&self, column: usize) -> &[Row] {
        let outputs = self.outputs();
        &self.transposed.rows()[column * outputs..][..outputs]
    }

    /// Updates the transposed weights after a step.
    pub fn transpose(&mut self) {
        let outputs = self.outputs();
        let weights = self.parameters.values.rows()[..self.inputs].chunks(PANEL);
        for (to, from) in self.transposed.rows_mut().chunks_mut(outputs).zip(weights) {
            for (output, row) in to.iter_mut().enumerate() {
                row.iter_mut().zip(from).for_each(|(to, from)| *to = from[output]);
            }
        }
    }
}

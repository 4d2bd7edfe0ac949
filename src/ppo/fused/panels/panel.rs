/*!
A panel of 32 outputs in training: differentiated and stepped as a unit.
*/

use crate::network::Layer;
use crate::network::kernels::{Buffer, padded, row_stride};
use crate::network::panel::{pack, panel_outputs};
use crate::ppo::fused::optimizer::Parameters;
use crate::ppo::fused::tree::Tree;

/// A panel in training.
#[derive(Debug)]
pub struct Panel {
    /// 0: policy, 1: value function.
    pub network: usize,
    /// Index of the layer.
    pub depth: usize,
    /// Inputs of the layer.
    pub inputs: usize,
    /// Outputs of the layer.
    pub layer_outputs: usize,
    /// First output.
    pub first: usize,
    /// Shape (inputs + 1, padded outputs of the panel), the bias last.
    pub parameters: Parameters,
    /// The weights the other way round, for the backward product; shape (outputs of the panel, inputs). Empty in the
    /// first layer, whose input needs no gradient.
    pub transposed: Buffer,
    /// Gradients of shards on their way to the sum.
    pub tree: Tree,
    /// Sum of squares of the gradient.
    pub squares: f64,
}

impl Panel {
    /// The panel that starts at output `first` of a layer and of its moments.
    pub fn new(network: usize, depth: usize, first: usize, [values, first_moment, second_moment]: [&Layer; 3]) -> Self {
        let (inputs, layer_outputs) = (values.inputs(), values.outputs());
        let transposed_rows = if depth == 0 { 0 } else { panel_outputs(layer_outputs, first) };
        let mut panel = Self {
            network,
            depth,
            inputs,
            layer_outputs,
            first,
            parameters: Parameters::new([values, first_moment, second_moment].map(|layer| pack(layer, first))),
            transposed: Buffer::zeros(transposed_rows * row_stride(inputs)),
            tree: Tree::default(),
            squares: 0.0,
        };
        panel.transpose();
        panel
    }

    /// Outputs, without padding.
    pub fn outputs(&self) -> usize {
        panel_outputs(self.layer_outputs, self.first)
    }

    /// Refreshes the transposed weights.
    pub fn transpose(&mut self) {
        let width = padded(self.outputs());
        for (i, row) in self.transposed.chunks_mut(row_stride(self.inputs)).enumerate() {
            let column = self.parameters.values[i..].iter().step_by(width);
            row[..self.inputs].iter_mut().zip(column).for_each(|(x, weight)| *x = *weight);
        }
    }
}

/*!
A panel of 32 outputs in training: differentiated and stepped as a unit.
*/

use crate::network::Layer;
use crate::network::kernels::{Buffer, PANEL, Row};
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
    /// A row for each input, the bias last.
    pub parameters: Parameters,
    /// The weights the other way round, for the backward product: panels of 32 inputs, a row for each output. Empty in the
    /// first layer, whose input needs no gradient.
    transposed: Buffer,
    /// Gradients of shards on their way to the sum.
    pub tree: Tree,
    /// Sum of squares of the gradient.
    pub squares: f64,
}

impl Panel {
    /// The panel that starts at output `first` of a layer and of its moments.
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
            parameters: Parameters::new([values, first_moment, second_moment].map(|layer| pack(layer, first))),
            transposed: Buffer::zeros(transposed),
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

    /// Weights by the 32 inputs that start at 32 `column`.
    pub fn transposed(&self, column: usize) -> &[Row] {
        let outputs = self.outputs();
        &self.transposed.rows()[column * outputs..][..outputs]
    }

    /// Refreshes the transposed weights.
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

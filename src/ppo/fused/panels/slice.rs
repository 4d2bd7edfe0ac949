//! A slice of a panel of 32 outputs in training, differentiated and stepped as a unit.

use crate::network::Layer;
use crate::network::kernels::{AlignedBuffer, PANEL, Row};
use crate::network::panel::{pack, panel_outputs, panel_starts};
use crate::ppo::fused::optimizer::AdamParameters;
use crate::ppo::fused::tree::Tree;

/// Number of inputs in a slice, except the last of a panel: few enough that 64 threads all have one.
pub const SLICE: usize = 2 * PANEL;

/// The weights from up to [`SLICE`] inputs to 32 outputs in training.
#[derive(Debug)]
pub struct Slice {
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
    /// Index of the slice's first input.
    pub from: usize,
    /// Weights: a row for each input; in the last slice of a panel the bias as last row.
    pub parameters: AdamParameters,
    /// Transposed weights for the backward product: panels of 32 inputs, a row for each output. Empty in the first
    /// layer, whose input needs no gradient.
    transposed: AlignedBuffer,
    /// Partial sums of the shards' gradients.
    pub tree: Tree,
    /// Sum of squares of the gradient.
    pub squares: f64,
}

impl Slice {
    /// Creates all slices of a layer, panel by panel, with their moments.
    pub fn all(network: usize, depth: usize, layers: [&Layer; 3]) -> Vec<Self> {
        let firsts = panel_starts(layers[0].outputs());
        let slices = |first: usize| {
            let packed = layers.map(|layer| pack(layer, first));
            let slice = |from| Self::new([network, depth, first, from], layers[0], &packed);
            (0..layers[0].inputs()).step_by(SLICE).map(slice).collect::<Vec<_>>()
        };
        firsts.flat_map(slices).collect()
    }

    fn new([network, depth, first, from]: [usize; 4], layer: &Layer, packed: &[AlignedBuffer; 3]) -> Self {
        let (inputs, layer_outputs) = (layer.inputs(), layer.outputs());
        let end = if from + SLICE >= inputs { inputs + 1 } else { from + SLICE };
        let part = |all: &AlignedBuffer| AlignedBuffer::from(&all[from * PANEL..end * PANEL]);
        let transposed = if depth == 0 { 0 } else { SLICE * panel_outputs(layer_outputs, first) };
        let mut slice = Self {
            network,
            depth,
            inputs,
            layer_outputs,
            first,
            from,
            parameters: AdamParameters::new(packed.each_ref().map(part)),
            transposed: AlignedBuffer::zeros(transposed),
            tree: Tree::default(),
            squares: 0.0,
        };
        slice.transpose();
        slice
    }

    /// Returns the number of inputs.
    fn own_inputs(&self) -> usize {
        SLICE.min(self.inputs - self.from)
    }

    methods! {
        /// Returns the number of slices of each panel of the layer.
        fn per_panel(&self) -> usize = self.inputs.div_ceil(SLICE);
        /// Returns true if the last row is the bias.
        fn has_bias(&self) -> bool = self.from + SLICE >= self.inputs;
        /// Returns the number of outputs, without padding.
        fn outputs(&self) -> usize = panel_outputs(self.layer_outputs, self.first);
    }

    /// Returns the transposed weights of the 32 inputs that start at 32 · `column` of the slice.
    pub fn transposed(&self, column: usize) -> &[Row] {
        let outputs = self.outputs();
        &self.transposed.rows()[column * outputs..][..outputs]
    }

    /// Updates the transposed weights after a step.
    pub fn transpose(&mut self) {
        let outputs = self.outputs();
        let weights = self.parameters.values.rows()[..self.own_inputs()].chunks(PANEL);
        for (to, from) in self.transposed.rows_mut().chunks_mut(outputs).zip(weights) {
            for (output, row) in to.iter_mut().enumerate() {
                row.iter_mut().zip(from).for_each(|(to, from)| *to = from[output]);
            }
        }
    }
}

/*! A panel of 32 outputs of a layer, stored in tiles.

Parameters are stored as the tile unit returns the gradient: blocks of 32 outputs by 32 inputs, each as four tiles of 16
× 16, row by row; the biases last. Padding is zero, and stays zero, because its gradient is zero.
*/

use pulp::x86::V4;
use pulp::{NullaryFnOnce, cast};

use super::pack::{put, split, transpose};
use super::unit::{Operand, SQUARE};
use crate::network::Layer;
use crate::network::kernels::AlignedBuffer;
use crate::ppo::fused::optimizer::AdamParameters;
use crate::ppo::fused::tree::Tree;

/// A panel of 32 outputs in training.
#[derive(Debug)]
pub struct TilePanel {
    /// Index of the network: 0 for the policy, 1 for the value function.
    pub network: usize,
    /// Index of the layer.
    pub depth: usize,
    /// Index of the panel in its layer.
    pub index: usize,
    pub parameters: AdamParameters,
    /// Right operands of the forward product, one for each 32 inputs.
    pub forward: Vec<Operand<2>>,
    /// Right operands of the backward product; empty in the first layer, whose input needs no gradient.
    pub backward: Vec<Operand<1>>,
    /// Partial sums of the shards' gradients.
    pub tree: Tree,
    /// Sum of squares of the gradient.
    pub squares: f64,
}

impl TilePanel {
    /// Creates panel `index` of a layer, with its moments.
    pub fn new(network: usize, depth: usize, index: usize, layers: [&Layer; 3], simd: V4) -> Self {
        let inputs = layers[0].inputs().div_ceil(32);
        let parameters = AdamParameters::new(layers.map(|layer| pack(layer, index)));
        let forward = vec![Operand::ZERO; inputs];
        let (backward, tree) = (vec![Operand::ZERO; if depth == 0 { 0 } else { inputs }], Tree::default());
        let mut panel = Self { network, depth, index, parameters, forward, backward, tree, squares: 0.0 };
        panel.refresh(simd);
        panel
    }

    /// Updates the operands from the parameters after a step.
    pub fn refresh(&mut self, simd: V4) {
        simd.vectorize(Refresh { simd, panel: self });
    }

    pub fn bias(&self) -> &[f32] {
        &self.parameters.values[self.forward.len() * SQUARE..]
    }
}

struct Refresh<'a> {
    simd: V4,
    panel: &'a mut TilePanel,
}

impl NullaryFnOnce for Refresh<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { simd, panel } = self;
        let mut rows = Operand::<2>::ZERO;
        let (squares, _) = panel.parameters.values.as_chunks::<SQUARE>();
        for (index, (square, forward)) in squares.iter().zip(&mut panel.forward).enumerate() {
            let (square, _) = square.as_chunks::<16>();
            for row in 0..16 {
                // By halves of outputs and of inputs.
                let [a, b, c, d] = [0, 16, 32, 48].map(|tile| cast(square[tile + row]));
                let [w00, w01, w10, w11] =
                    [split::<2>(simd, a), split::<2>(simd, b), split::<2>(simd, c), split::<2>(simd, d)];
                put(simd, &mut rows, (0, row), w00, w01);
                put(simd, &mut rows, (1, row), w10, w11);
                if let Some(backward) = panel.backward.get_mut(index) {
                    put(simd, backward, (0, row), w00, w10);
                    put(simd, backward, (1, row), w01, w11);
                }
            }
            transpose(simd, &rows, forward);
        }
    }
}

/// Returns the position of the weight from an input to an output in a panel.
fn place(output: usize, input: usize) -> usize {
    let (block, output, input) = (input / 32, output % 32, input % 32);
    block * SQUARE + (output / 16 * 2 + input / 16) * 256 + output % 16 * 16 + input % 16
}

fn panel_outputs(layer: &Layer, index: usize) -> std::ops::Range<usize> {
    index * 32..layer.outputs().min((index + 1) * 32)
}

fn pack(layer: &Layer, index: usize) -> AlignedBuffer {
    let (inputs, biases) = (layer.inputs(), layer.inputs().div_ceil(32) * SQUARE);
    let mut values = AlignedBuffer::zeros(biases + 32);
    for output in panel_outputs(layer, index) {
        values[biases + output % 32] = layer.bias[output];
        for input in 0..inputs {
            values[place(output, input)] = layer.weight[output * inputs + input];
        }
    }
    values
}

/// Writes the values of a panel back into a layer; the inverse of `pack`.
pub fn unpack(values: &[f32], index: usize, layer: &mut Layer) {
    let (inputs, biases) = (layer.inputs(), layer.inputs().div_ceil(32) * SQUARE);
    for output in panel_outputs(layer, index) {
        layer.bias[output] = values[biases + output % 32];
        for input in 0..inputs {
            layer.weight[output * inputs + input] = values[place(output, input)];
        }
    }
}

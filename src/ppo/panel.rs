/*!
Layers cut into panels of 32 outputs, the unit in which weights are stored, differentiated and stepped.
*/

use pulp::Arch;

use super::Layer;
use super::kernels::{Buffer, Ends, PANEL, Product, Stretch, padded, row_stride};
use super::optimizer::Parameters;

/// First output of each panel of a layer with `outputs` outputs.
pub fn panel_starts(outputs: usize) -> impl Iterator<Item = usize> {
    (0..outputs).step_by(PANEL)
}

/// Outputs in the panel that starts at `first`, without padding.
pub fn panel_outputs(outputs: usize, first: usize) -> usize {
    PANEL.min(outputs - first)
}

/// The panel that starts at output `first`; shape (inputs + 1, padded outputs of the panel), the bias last.
pub fn pack(layer: &Layer, first: usize) -> Buffer {
    let inputs = layer.inputs();
    let outputs = panel_outputs(layer.outputs(), first);
    let mut values = Buffer::zeros((inputs + 1) * padded(outputs));
    for i in 0..outputs {
        let weights = &layer.weight[(first + i) * inputs..][..inputs];
        let column = values[i..].iter_mut().step_by(padded(outputs));
        column.zip(weights.iter().chain([&layer.bias[first + i]])).for_each(|(value, parameter)| *value = *parameter);
    }
    values
}

/// The inverse of [`pack`].
pub fn unpack(values: &[f32], first: usize, layer: &mut Layer) {
    let inputs = layer.inputs();
    let outputs = panel_outputs(layer.outputs(), first);
    for i in 0..outputs {
        let weights = &mut layer.weight[(first + i) * inputs..][..inputs];
        let column = values[i..].iter().step_by(padded(outputs));
        column
            .zip(weights.iter_mut().chain([&mut layer.bias[first + i]]))
            .for_each(|(value, parameter)| *parameter = *value);
    }
}

/// A layer's output for a block of rows, panel by panel. Rows of `y` are [`row_stride`] of the outputs apart.
pub fn forward<'a>(
    arch: Arch,
    rows: usize,
    (x, x_stride): (&[f32], usize),
    panels: impl Iterator<Item = &'a [f32]>,
    outputs: usize,
    elu: bool,
    y: &mut [f32],
) {
    for (panel, first) in panels.zip(panel_starts(outputs)) {
        let width = padded(panel_outputs(outputs, first));
        let (weights, bias) = panel.split_at(panel.len() - width);
        let product = Product {
            rows,
            columns: width,
            stretches: &[Stretch { depth: weights.len() / width, a: x, b: weights }],
            a_transposed: false,
            a_stride: x_stride,
            b_stride: width,
            ends: Ends::Bias { bias, elu },
            c: &mut y[first..],
            c_stride: row_stride(outputs),
        };
        product.compute(arch);
    }
}

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

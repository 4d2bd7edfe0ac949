/*!
Layers cut into panels of 32 outputs, the unit in which weights are stored.
*/

use pulp::Arch;

use super::Layer;
use super::kernels::{Buffer, Ends, PANEL, Product, Stretch, padded, row_stride};

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

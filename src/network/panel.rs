//! Layers split into panels of 32 outputs, the unit in which weights are stored.

use pulp::Arch;

use super::Layer;
use super::kernels::{AlignedBuffer, Ends, Matrix, PANEL, Product, Stretch};

/// Iterates over the first output of each panel of a layer with `outputs` outputs.
pub fn panel_starts(outputs: usize) -> impl Iterator<Item = usize> {
    (0..outputs).step_by(PANEL)
}

/// Returns the number of outputs in the panel that starts at `first`, without padding.
pub fn panel_outputs(outputs: usize, first: usize) -> usize {
    PANEL.min(outputs - first)
}

/// Packs the panel that starts at output `first`: a row for each input, the bias last.
pub fn pack(layer: &Layer, first: usize) -> AlignedBuffer {
    let inputs = layer.inputs();
    let mut values = AlignedBuffer::zeros((inputs + 1) * PANEL);
    let rows = values.rows_mut();
    for i in 0..panel_outputs(layer.outputs(), first) {
        let weights = &layer.weight[(first + i) * inputs..][..inputs];
        rows.iter_mut().zip(weights.iter().chain([&layer.bias[first + i]])).for_each(|(row, value)| row[i] = *value);
    }
    values
}

/// Writes the values of a panel back into a layer; the inverse of [`pack`].
pub fn unpack(values: &AlignedBuffer, first: usize, layer: &mut Layer) {
    let inputs = layer.inputs();
    for i in 0..panel_outputs(layer.outputs(), first) {
        let weights = layer.weight[(first + i) * inputs..][..inputs].iter_mut();
        values.rows().iter().zip(weights.chain([&mut layer.bias[first + i]])).for_each(|(row, value)| *value = row[i]);
    }
}

/// Computes a layer's output for the first `rows` rows of `x`, panel by panel.
pub fn forward<'a>(
    arch: Arch,
    rows: usize,
    x: &Matrix,
    panels: impl Iterator<Item = &'a AlignedBuffer>,
    outputs: usize,
    elu: bool,
    y: &mut Matrix,
) {
    let mut stretches = Vec::new();
    for ((panel, first), c) in panels.zip(panel_starts(outputs)).zip(y.panels_mut()) {
        let Some((bias, weights)) = panel.rows().split_last() else { return };
        stretches.clear();
        stretches.extend(x.panels().zip(weights.chunks(PANEL)).map(|(a, b)| Stretch { a, b }));
        let (columns, ends) = (panel_outputs(outputs, first), Ends::Bias { bias, elu });
        Product { rows, columns, stretches: &stretches, a_transposed: false, ends, c }.compute(arch);
    }
}

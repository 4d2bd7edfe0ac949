//! Layers split into panels of 32 outputs, the unit in which weights are stored.

use pulp::Arch;

use super::Layer;
use super::kernels::{AlignedBuffer, Ends, Matrix, PANEL, Product, Row, Stretch};

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

/// Writes rows of a panel, from that of input `from` on, back into a layer; the inverse of [`pack`].
pub fn unpack(rows: &[Row], first: usize, from: usize, layer: &mut Layer) {
    let inputs = layer.inputs();
    for i in 0..panel_outputs(layer.outputs(), first) {
        let weights = layer.weight[(first + i) * inputs..][from..inputs].iter_mut();
        rows.iter().zip(weights.chain([&mut layer.bias[first + i]])).for_each(|(row, value)| *value = row[i]);
    }
}

/// Computes a layer's output for the first `rows` rows of `x`, panel by panel. `slices` are the rows of all panels, and the
/// number of slices of each; all but the last of a panel have a multiple of 32 rows.
pub fn forward<'a>(
    arch: Arch,
    rows: usize,
    x: &Matrix,
    (mut slices, slices_per_panel): (impl Iterator<Item = &'a [Row]>, usize),
    outputs: usize,
    elu: bool,
    y: &mut Matrix,
) {
    let mut stretches = Vec::new();
    for (first, c) in panel_starts(outputs).zip(y.panels_mut()) {
        stretches.clear();
        let (mut columns, mut bias) = (x.panels(), None);
        for slice in 1..=slices_per_panel {
            let Some(mut weights) = slices.next() else { return };
            if slice == slices_per_panel {
                (bias, weights) = weights.split_last().map_or((None, weights), |(bias, weights)| (Some(bias), weights));
            }
            stretches.extend(weights.chunks(PANEL).zip(columns.by_ref()).map(|(b, a)| Stretch { a, b }));
        }
        let Some(bias) = bias else { return };
        let (columns, ends) = (panel_outputs(outputs, first), Ends::Bias { bias, elu });
        Product { rows, columns, stretches: &stretches, a_transposed: false, ends, c }.compute(arch);
    }
}

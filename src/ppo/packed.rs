/*!
Weights rearranged for the kernels, and inference with them.
*/

use pulp::Arch;

use super::kernels::{Buffer, Forward, PANEL, padded, row_stride};
use super::{Layer, Mlp};

/// Rows that go through a network together: their activations stay in the cache between layers.
pub const BLOCK: usize = 64;

/// Number of panels of a layer with `outputs` outputs.
pub fn panel_count(outputs: usize) -> usize {
    outputs.div_ceil(PANEL)
}

/// Outputs in a layer's panel, without padding.
pub fn panel_outputs(outputs: usize, panel: usize) -> usize {
    PANEL.min(outputs - panel * PANEL)
}

/// Writes one panel of a layer; shape (inputs + 1, padded outputs of the panel), the bias last.
pub fn pack(layer: &Layer, panel: usize, values: &mut [f32]) {
    let inputs = layer.inputs();
    let width = values.len() / (inputs + 1);
    for i in 0..panel_outputs(layer.outputs(), panel) {
        let output = panel * PANEL + i;
        for (input, weight) in layer.weight[output * inputs..][..inputs].iter().enumerate() {
            values[input * width + i] = *weight;
        }
        values[inputs * width + i] = layer.bias[output];
    }
}

/// The inverse of [`pack`].
pub fn unpack(values: &[f32], panel: usize, layer: &mut Layer) {
    let inputs = layer.inputs();
    let width = values.len() / (inputs + 1);
    for i in 0..panel_outputs(layer.outputs(), panel) {
        let output = panel * PANEL + i;
        for (input, weight) in layer.weight[output * inputs..][..inputs].iter_mut().enumerate() {
            *weight = values[input * width + i];
        }
        layer.bias[output] = values[inputs * width + i];
    }
}

/// A layer's output for a block of rows. `y` has [`row_stride`] of the outputs.
#[allow(clippy::too_many_arguments)]
pub fn forward_layer<'a>(
    arch: Arch,
    rows: usize,
    x: &[f32],
    x_stride: usize,
    panels: impl Iterator<Item = &'a [f32]>,
    outputs: usize,
    elu: bool,
    y: &mut [f32],
) {
    let y_stride = row_stride(outputs);
    for (i, panel) in panels.enumerate() {
        let width = padded(panel_outputs(outputs, i));
        arch.dispatch(Forward {
            rows,
            x,
            x_stride,
            panel,
            width,
            elu,
            y: &mut y[i * PANEL..],
            y_stride,
        });
    }
}

/// A network ready for evaluation. Rows may be evaluated in any grouping, on any number of threads at once: each row's
/// bits stay the same.
#[derive(Debug)]
pub struct PackedMlp {
    arch: Arch,
    inputs: usize,
    layers: Vec<PackedLayer>,
}

#[derive(Debug)]
struct PackedLayer {
    outputs: usize,
    panels: Vec<Buffer>,
}

/// Intermediate activations of [`PackedMlp::forward`]; one for each thread.
#[derive(Debug)]
pub struct Scratch {
    buffers: [Buffer; 2],
}

impl PackedMlp {
    /// Packs the weights.
    pub fn new(mlp: &Mlp) -> Self {
        let pack_layer = |layer: &Layer| {
            let pack_panel = |panel| {
                let width = padded(panel_outputs(layer.outputs(), panel));
                let mut values = Buffer::zeros((layer.inputs() + 1) * width);
                pack(layer, panel, &mut values);
                values
            };
            let outputs = layer.outputs();
            PackedLayer {
                outputs,
                panels: (0..panel_count(outputs)).map(pack_panel).collect(),
            }
        };
        Self {
            arch: Arch::new(),
            inputs: mlp.inputs(),
            layers: mlp.layers.iter().map(pack_layer).collect(),
        }
    }

    /// Evaluates `inputs`, shape (rows, inputs), to `outputs`, shape (rows, outputs). Allocates only when `scratch` is
    /// new or has served smaller networks.
    ///
    /// # Panics
    /// When the slices do not have these shapes.
    pub fn forward(&self, rows: usize, inputs: &[f32], outputs: &mut [f32], scratch: &mut Scratch) {
        let output_count = self.layers.last().map_or(self.inputs, |layer| layer.outputs);
        assert_eq!(
            inputs.len(),
            rows * self.inputs,
            "inputs must have shape (rows, inputs)"
        );
        assert_eq!(
            outputs.len(),
            rows * output_count,
            "outputs must have shape (rows, outputs)"
        );

        let widest = self
            .layers
            .iter()
            .map(|layer| row_stride(layer.outputs))
            .max()
            .unwrap_or(0);
        let [mut x, mut y] = scratch.at_least(BLOCK * widest);
        let blocks = inputs
            .chunks(BLOCK * self.inputs)
            .zip(outputs.chunks_mut(BLOCK * output_count));
        for (block, out) in blocks {
            let rows = block.len() / self.inputs;
            let mut x_stride = self.inputs;
            for (i, layer) in self.layers.iter().enumerate() {
                let input = if i == 0 { block } else { &*x };
                let elu = i + 1 < self.layers.len();
                let panels = layer.panels.iter().map(|panel| &**panel);
                forward_layer(self.arch, rows, input, x_stride, panels, layer.outputs, elu, y);
                x_stride = row_stride(layer.outputs);
                std::mem::swap(&mut x, &mut y);
            }
            for (out, row) in out.chunks_mut(output_count).zip(x.chunks(x_stride)) {
                out.copy_from_slice(&row[..output_count]);
            }
        }
    }
}

impl Scratch {
    fn at_least(&mut self, len: usize) -> [&mut [f32]; 2] {
        if self.buffers[0].len() < len {
            self.buffers = [Buffer::zeros(len), Buffer::zeros(len)];
        }
        self.buffers.each_mut().map(|buffer| &mut **buffer)
    }
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            buffers: [Buffer::zeros(0), Buffer::zeros(0)],
        }
    }
}

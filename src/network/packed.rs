/*!
Inference, with weights rearranged for the kernels.
*/

use pulp::Arch;

use super::kernels::{Buffer, row_stride};
use super::panel::{self, pack, panel_starts};
use super::{Layer, Mlp};

/// Rows that go through a network together: their activations stay in the cache between layers.
pub const BLOCK: usize = 64;

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

impl Default for Scratch {
    fn default() -> Self {
        Self { buffers: [Buffer::zeros(0), Buffer::zeros(0)] }
    }
}

impl PackedMlp {
    /// Packs the weights.
    pub fn new(mlp: &Mlp) -> Self {
        let pack_layer = |layer: &Layer| PackedLayer {
            outputs: layer.outputs(),
            panels: panel_starts(layer.outputs()).map(|first| pack(layer, first)).collect(),
        };
        Self { arch: Arch::new(), inputs: mlp.inputs(), layers: mlp.layers.iter().map(pack_layer).collect() }
    }

    /// Width of the input.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Width of the output.
    pub fn outputs(&self) -> usize {
        self.layers.last().map_or(self.inputs, |layer| layer.outputs)
    }

    /// Evaluates `inputs`, shape (rows, inputs), to `outputs`, shape (rows, outputs). Allocates only when `scratch` is
    /// new or has served narrower networks.
    ///
    /// # Panics
    /// When the slices do not have these shapes.
    pub fn forward(&self, rows: usize, inputs: &[f32], outputs: &mut [f32], scratch: &mut Scratch) {
        let output_count = self.outputs();
        assert_eq!(inputs.len(), rows * self.inputs, "inputs must have shape (rows, inputs)");
        assert_eq!(outputs.len(), rows * output_count, "outputs must have shape (rows, outputs)");

        let widest = self.layers.iter().map(|layer| row_stride(layer.outputs)).max().unwrap_or(0);
        if scratch.buffers[0].len() < BLOCK * widest {
            scratch.buffers = [Buffer::zeros(BLOCK * widest), Buffer::zeros(BLOCK * widest)];
        }
        let [mut x, mut y] = scratch.buffers.each_mut();
        for (block, out) in inputs.chunks(BLOCK * self.inputs).zip(outputs.chunks_mut(BLOCK * output_count)) {
            let rows = block.len() / self.inputs;
            let mut x_stride = self.inputs;
            for (i, layer) in self.layers.iter().enumerate() {
                let input = if i == 0 { block } else { &**x };
                let elu = i + 1 < self.layers.len();
                let panels = layer.panels.iter().map(|panel| &**panel);
                panel::forward(self.arch, rows, (input, x_stride), panels, layer.outputs, elu, y);
                x_stride = row_stride(layer.outputs);
                std::mem::swap(&mut x, &mut y);
            }
            for (out, row) in out.chunks_mut(output_count).zip(x.chunks(x_stride)) {
                out.copy_from_slice(&row[..output_count]);
            }
        }
    }
}

//! Inference of a network whose weights are rearranged for the SIMD kernels.

use pulp::Arch;

use super::kernels::{AlignedBuffer, Matrix};
use super::panel::{self, pack, panel_starts};
use super::{Layer, Mlp};

/// Number of rows evaluated together, so that their activations stay in the cache between layers.
pub const BLOCK: usize = 64;

/// A network packed for evaluation. Rows may be evaluated in any grouping and on any number of threads: the bits of
/// each row stay the same.
#[derive(Debug)]
pub struct PackedMlp {
    arch: Arch,
    inputs: usize,
    layers: Vec<PackedLayer>,
}

#[derive(Debug)]
struct PackedLayer {
    outputs: usize,
    panels: Vec<AlignedBuffer>,
}

/// Intermediate activations of [`PackedMlp::forward`]; each thread needs its own.
#[derive(Debug)]
pub struct Scratch {
    /// Input and output of a layer.
    activations: [Matrix; 2],
}

impl Default for Scratch {
    fn default() -> Self {
        Self { activations: [(); 2].map(|()| Matrix::zeros(BLOCK, 0)) }
    }
}

impl PackedMlp {
    /// Packs the weights of a network.
    pub fn new(mlp: &Mlp) -> Self {
        let pack_layer = |layer: &Layer| PackedLayer {
            outputs: layer.outputs(),
            panels: panel_starts(layer.outputs()).map(|first| pack(layer, first)).collect(),
        };
        Self { arch: Arch::new(), inputs: mlp.inputs(), layers: mlp.layers.iter().map(pack_layer).collect() }
    }

    /// Returns the number of inputs.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Returns the number of outputs.
    pub fn outputs(&self) -> usize {
        self.layers.last().map_or(self.inputs, |layer| layer.outputs)
    }

    /// Evaluates `inputs`, shape (rows, inputs), into `outputs`, shape (rows, outputs). Allocates almost nothing once
    /// `scratch` has served a network of this width.
    ///
    /// # Panics
    /// The slices do not have these shapes.
    pub fn forward(&self, rows: usize, inputs: &[f32], outputs: &mut [f32], scratch: &mut Scratch) {
        let output_count = self.outputs();
        assert_eq!(inputs.len(), rows * self.inputs, "inputs must have shape (rows, inputs)");
        assert_eq!(outputs.len(), rows * output_count, "outputs must have shape (rows, outputs)");

        let widest = self.layers.iter().map(|layer| layer.outputs).fold(self.inputs, usize::max);
        if scratch.activations[0].columns() < widest {
            scratch.activations = [(); 2].map(|()| Matrix::zeros(BLOCK, widest));
        }
        let [mut x, mut y] = scratch.activations.each_mut();
        for (block, out) in inputs.chunks(BLOCK * self.inputs).zip(outputs.chunks_mut(BLOCK * output_count)) {
            block.chunks(self.inputs).enumerate().for_each(|(row, values)| x.set_row(row, values));
            let rows = block.len() / self.inputs;
            for (i, layer) in self.layers.iter().enumerate() {
                let elu = i + 1 < self.layers.len();
                let panels = layer.panels.iter().map(AlignedBuffer::rows);
                panel::forward(self.arch, rows, x, (panels, 1), layer.outputs, elu, y);
                std::mem::swap(&mut x, &mut y);
            }
            out.chunks_mut(output_count).enumerate().for_each(|(row, values)| x.read_row(row, values));
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn what_a_wider_network_has_left_in_the_scratch_does_not_count() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let narrow = PackedMlp::new(&Mlp::orthogonal(&[5, 40, 3], 1.0, &mut rng));
        let wide = PackedMlp::new(&Mlp::orthogonal(&[70, 100, 50], 1.0, &mut rng));
        let mut used = Scratch::default();
        wide.forward(3, &[f32::NAN; 3 * 70], &mut [0.0; 3 * 50], &mut used);
        let evaluate = |scratch: &mut Scratch| {
            let mut y = [0.0; 2 * 3];
            narrow.forward(2, &[0.1, -0.2, 0.3, -0.4, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0], &mut y, scratch);
            y
        };
        assert_eq!(evaluate(&mut used), evaluate(&mut Scratch::default()));
    }
}

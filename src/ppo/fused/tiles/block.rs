/*! Forward and backward pass of one network over 64 rows of a minibatch, as two halves of 32, so that the weights of a
product are loaded once for both.

Between two layers 32 columns at a time come out of the tile unit as sums, and the vector units turn them into operands.
*/

use pulp::x86::V4;
use pulp::{NullaryFnOnce, Simd, cast, f32x16};
use std::arch::x86_64::_CMP_NGT_UQ;
use std::mem;

use super::pack::{get, put, split, transpose};
use super::panel::TilePanel;
use super::unit::{Operand, SQUARE, Square, TileUnit};
use crate::network::Mlp;
use crate::network::kernels::AlignedBuffer;
use crate::ppo::fused::LayerPanels;
use crate::ppo::fused::losses::Pass;

/// Number of rows in a block.
pub const ROWS: usize = 32 * HALVES;

/// Number of products of 32 rows in a block.
pub const HALVES: usize = 2;

/// Inputs and deltas of up to 64 rows, for the gradients of the weights. Columns are counted in units of 32.
#[derive(Debug)]
pub struct TileBlock {
    /// Input of each layer as right operands, one for each 32 columns.
    pub inputs: Vec<Vec<[Operand<1>; HALVES]>>,
    /// Gradient of the loss by each layer's output before ELU, as left operands, one for each 32 columns.
    pub deltas: Vec<Vec<[Operand<1>; HALVES]>>,
    /// Sums of each layer's deltas over the rows.
    pub bias: Vec<AlignedBuffer>,
    /// Output of the last layer, shape (64, columns of the last layer).
    outputs: AlignedBuffer,
    output_deltas: AlignedBuffer,
}

/// Scratch memory of one thread for a block, reused from block to block.
pub struct Workspace {
    pub unit: TileUnit,
    /// Left operands of the forward product: a layer's input and output.
    forward: [Vec<[Operand<2>; HALVES]>; 2],
    /// Left operands of the backward product: the gradients by a layer's output and input.
    backward: [Vec<[Operand<1>; HALVES]>; 2],
    /// Sums from the tile unit.
    sums: AlignedBuffer,
    /// Deltas before they are transposed.
    rows: Operand<1>,
}

impl Workspace {
    /// Allocates scratch memory for layers of up to `widest` columns, in units of 32.
    pub fn new(unit: TileUnit, widest: usize) -> Self {
        let forward = [(); 2].map(|()| vec![[Operand::ZERO; HALVES]; widest]);
        let backward = [(); 2].map(|()| vec![[Operand::ZERO; HALVES]; widest]);
        Self { unit, forward, backward, sums: AlignedBuffer::zeros(SQUARE), rows: Operand::ZERO }
    }
}

impl TileBlock {
    /// Allocates room for one block of `mlp`.
    pub fn new(mlp: &Mlp) -> Self {
        let operands = |columns: usize| vec![[Operand::ZERO; HALVES]; columns.div_ceil(32)];
        let outputs = ROWS * mlp.outputs().next_multiple_of(32);
        Self {
            inputs: mlp.layers.iter().map(|layer| operands(layer.inputs())).collect(),
            deltas: mlp.layers.iter().map(|layer| operands(layer.outputs())).collect(),
            bias: mlp.layers.iter().map(|layer| AlignedBuffer::zeros(layer.outputs().next_multiple_of(32))).collect(),
            outputs: AlignedBuffer::zeros(outputs),
            output_deltas: AlignedBuffer::zeros(outputs),
        }
    }

    /// Gathers the observations of `rows` and evaluates the network.
    pub fn forward(
        &mut self,
        workspace: &mut Workspace,
        layers: &[LayerPanels<'_, '_, TilePanel>],
        (observations, size): (&[f32], usize),
        rows: &[u32],
    ) {
        workspace.unit.simd.vectorize(Forward { block: self, workspace, layers, observations, size, rows });
    }

    /// Computes the loss between the forward and the backward pass.
    pub fn pass(&mut self, network: usize, block: usize) -> Pass<'_> {
        // Rows that are not in use have no loss.
        self.output_deltas.fill(0.0);
        let stride = self.outputs.len() / ROWS;
        Pass { network, block, stride, outputs: &self.outputs, deltas: &mut self.output_deltas }
    }

    /// Propagates the loss gradient from the last layer's output back to the first layer's.
    pub fn backward(&mut self, workspace: &mut Workspace, layers: &[LayerPanels<'_, '_, TilePanel>]) {
        workspace.unit.simd.vectorize(Backward { block: self, workspace, layers });
    }
}

struct Forward<'a, 'b> {
    block: &'a mut TileBlock,
    workspace: &'a mut Workspace,
    layers: &'a [LayerPanels<'a, 'b, TilePanel>],
    observations: &'a [f32],
    size: usize,
    rows: &'a [u32],
}

impl NullaryFnOnce for Forward<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { block, workspace, layers, observations, size, rows } = self;
        let Workspace { unit, forward: [input, output], sums, .. } = workspace;
        let simd = unit.simd;
        let sums = square(sums);
        gather(simd, (observations, size), rows, input, &mut block.inputs[0]);
        let last = layers.len() - 1;
        for (panels, inputs) in layers[..last].iter().zip(&mut block.inputs[1..]) {
            for product in 0..HALVES * panels.len() {
                let (column, half) = (product / HALVES, product % HALVES);
                let panel = &panels[column];
                let steps = input.iter().zip(&panel.forward).map(|(left, right)| (&left[half], right));
                unit.product(steps, sums, false);
                put_outputs(simd, sums, panel.bias(), &mut output[column][half], &mut inputs[column][half]);
            }
            mem::swap(input, output);
        }
        let columns = 32 * layers[last].len();
        for (column, panel) in layers[last].iter().enumerate() {
            let bias = [load(panel.bias()), load(&panel.bias()[16..])];
            for half in 0..HALVES {
                let steps = input.iter().zip(&panel.forward).map(|(left, right)| (&left[half], right));
                unit.product(steps, sums, false);
                for row in 0..16 {
                    for (quarter, values) in rows_of(sums, row).into_iter().enumerate() {
                        let output = &mut block.outputs[(32 * half + 16 * quarter + row) * columns + 32 * column..];
                        store(output, simd.add_f32s(values[0], bias[0]));
                        store(&mut output[16..], simd.add_f32s(values[1], bias[1]));
                    }
                }
            }
        }
    }
}

fn square(buffer: &mut AlignedBuffer) -> &mut Square {
    buffer.first_chunk_mut().expect("made of that size")
}

#[inline(always)]
fn load(from: &[f32]) -> f32x16 {
    let line: &[f32; 16] = from.first_chunk().unwrap_or(&[0.0; 16]);
    cast(*line)
}

#[inline(always)]
fn store(to: &mut [f32], value: f32x16) {
    if let Some(line) = to.first_chunk_mut::<16>() {
        *line = cast(value);
    }
}

/// Converts the observations of `rows` to operands; missing rows become zero.
#[inline(always)]
fn gather(
    simd: V4,
    observations: (&[f32], usize),
    rows: &[u32],
    left: &mut [[Operand<2>; HALVES]],
    right: &mut [[Operand<1>; HALVES]],
) {
    for half in 0..HALVES {
        for row in 0..16 {
            let (upper, lower) = (rows.get(32 * half + row), rows.get(32 * half + 16 + row));
            for (column, (left, right)) in left.iter_mut().zip(right.iter_mut()).enumerate() {
                let values = [lanes(simd, observations, upper, column), lanes(simd, observations, lower, column)];
                put_both(simd, row, values, &mut left[half], &mut right[half]);
            }
        }
    }
}

/// Reads 32 columns of an observation.
#[inline(always)]
fn lanes(simd: V4, (observations, size): (&[f32], usize), row: Option<&u32>, column: usize) -> [f32x16; 2] {
    let observation = row.map_or(&[][..], |&row| &observations[row as usize * size..][..size]);
    [line(simd, observation, 32 * column), line(simd, observation, 32 * column + 16)]
}

#[inline(always)]
fn line(simd: V4, observation: &[f32], start: usize) -> f32x16 {
    let rest = &observation[start.min(observation.len())..];
    match rest.first_chunk::<16>() {
        Some(line) => cast(*line),
        None => simd.partial_load_f32s(rest),
    }
}

/// Writes rows `row` and `row + 16` of 32 columns to a left operand and to a right one.
#[inline(always)]
fn put_both<const L: usize>(
    simd: V4,
    row: usize,
    values: [[f32x16; 2]; 2],
    left: &mut Operand<L>,
    right: &mut Operand<1>,
) {
    let [[a, b], [c, d]] = values;
    let (a, b) = (split::<L>(simd, a), split::<L>(simd, b));
    let (c, d) = (split::<L>(simd, c), split::<L>(simd, d));
    put(simd, left, (0, row), a, b);
    put(simd, left, (1, row), c, d);
    put(simd, right, (0, row), a, c);
    put(simd, right, (1, row), b, d);
}

/// Returns rows `row` and `row + 16` of 32 × 32 sums.
#[inline(always)]
fn rows_of(sums: &Square, row: usize) -> [[f32x16; 2]; 2] {
    let (rows, _) = sums.as_chunks::<16>();
    [[cast(rows[row]), cast(rows[16 + row])], [cast(rows[32 + row]), cast(rows[48 + row])]]
}

/// Converts sums to a hidden layer's output, as operands of the next layer.
#[inline(always)]
fn put_outputs(simd: V4, sums: &Square, bias: &[f32], left: &mut Operand<2>, right: &mut Operand<1>) {
    let bias = [load(bias), load(&bias[16..])];
    for row in 0..16 {
        let [[a, b], [c, d]] = rows_of(sums, row);
        let upper = [activate(simd, a, bias[0]), activate(simd, b, bias[1])];
        let lower = [activate(simd, c, bias[0]), activate(simd, d, bias[1])];
        put_both(simd, row, [upper, lower], left, right);
    }
}

/// Computes ELU of a sum and its bias, with an error of 2e-7, less than that of bf16 products.
///
/// With `n = round(x / ln 2)` and `r = x / ln 2 − n`, `eˣ − 1` is `2ⁿ 2ʳ − 1`. The polynomial is the minimax fit of
/// `2ʳ` on `|r| ≤ ½` that is exact at zero.
#[inline(always)]
fn activate(simd: V4, sum: f32x16, bias: f32x16) -> f32x16 {
    const C: [f32; 5] = [std::f32::consts::LN_2, 0.240_222_42, 0.055_507_336, 0.009_671_513, 0.001_326_472_7];
    let avx = simd.avx512f;
    let x = simd.add_f32s(sum, bias);
    let exponent = simd.mul_f32s(x, simd.splat_f32s(std::f32::consts::LOG2_E));
    let n = avx._mm512_roundscale_ps::<0>(cast(exponent));
    let r = simd.sub_f32s(exponent, cast(n));
    let mut p = simd.splat_f32s(C[4]);
    for c in [C[3], C[2], C[1], C[0], 1.0] {
        p = simd.mul_add_f32s(p, r, simd.splat_f32s(c));
    }
    // NaN is not above zero.
    let below = avx._mm512_cmp_ps_mask::<_CMP_NGT_UQ>(cast(x), avx._mm512_setzero_ps());
    let one = cast(simd.splat_f32s(1.0));
    cast(avx._mm512_mask_sub_ps(cast(x), below, avx._mm512_scalef_ps(cast(p), n), one))
}

struct Backward<'a, 'b> {
    block: &'a mut TileBlock,
    workspace: &'a mut Workspace,
    layers: &'a [LayerPanels<'a, 'b, TilePanel>],
}

impl NullaryFnOnce for Backward<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { block, workspace, layers } = self;
        let Workspace { unit, backward: [after, ahead], sums, rows, .. } = workspace;
        let simd = unit.simd;
        let sums = square(sums);
        block.bias.iter_mut().for_each(|bias| bias.fill(0.0));
        let last = layers.len() - 1;
        let columns = 32 * layers[last].len();
        for (column, deltas) in block.deltas[last].iter_mut().enumerate() {
            let bias = &mut block.bias[last][32 * column..];
            for (half, delta) in deltas.iter_mut().enumerate() {
                for row in 0..16 {
                    let upper = &block.output_deltas[(32 * half + row) * columns + 32 * column..];
                    let lower = &block.output_deltas[(32 * half + 16 + row) * columns + 32 * column..];
                    let values = [[load(upper), load(&upper[16..])], [load(lower), load(&lower[16..])]];
                    add_rows(simd, bias, values);
                    put_both(simd, row, values, &mut after[column][half], rows);
                }
                transpose(simd, rows, delta);
            }
        }
        for depth in (1..layers.len()).rev() {
            let (panels, y) = (layers[depth], &block.inputs[depth]);
            let (bias, deltas) = (&mut block.bias[depth - 1], &mut block.deltas[depth - 1]);
            for product in 0..HALVES * y.len() {
                let (column, half) = (product / HALVES, product % HALVES);
                let steps = after.iter().zip(panels).map(|(left, panel)| (&left[half], &panel.backward[column]));
                unit.product(steps, sums, false);
                put_deltas(simd, sums, &y[column][half], &mut bias[32 * column..], &mut ahead[column][half], rows);
                transpose(simd, rows, &mut deltas[column][half]);
            }
            mem::swap(after, ahead);
        }
    }
}

/// Converts sums to the loss gradient of the layer before, as operands, and adds it to that of the biases. `y` is the
/// output of ELU in that layer.
#[inline(always)]
fn put_deltas(simd: V4, sums: &Square, y: &Operand<1>, bias: &mut [f32], left: &mut Operand<1>, rows: &mut Operand<1>) {
    for row in 0..16 {
        let [[a, b], [c, d]] = rows_of(sums, row);
        let ([ya, yc], [yb, yd]) = (get(simd, y, (0, row)), get(simd, y, (1, row)));
        let upper = [times_slope(simd, a, ya), times_slope(simd, b, yb)];
        let lower = [times_slope(simd, c, yc), times_slope(simd, d, yd)];
        add_rows(simd, bias, [upper, lower]);
        put_both(simd, row, [upper, lower], left, rows);
    }
}

/// Multiplies by ELU′, given ELU's output: 1 where positive, `y + 1` elsewhere.
#[inline(always)]
fn times_slope(simd: V4, delta: f32x16, y: f32x16) -> f32x16 {
    simd.mul_add_f32s(delta, simd.min_f32s(y, simd.splat_f32s(0.0)), delta)
}

/// Adds two rows of 32 numbers to sums.
#[inline(always)]
fn add_rows(simd: V4, sums: &mut [f32], [upper, lower]: [[f32x16; 2]; 2]) {
    for half in 0..2 {
        let sum = simd.add_f32s(load(&sums[16 * half..]), simd.add_f32s(upper[half], lower[half]));
        store(&mut sums[16 * half..], sum);
    }
}

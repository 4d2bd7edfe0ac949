/*! The matrix products and activations of the learner, in portable SIMD.

Three matrix products make up a training step of a linear layer: `y = x·Wᵀ + b`, `δx = δy·W` and `δWᵀ = xᵀ·δy`. All three are the same sum
`c[m, n] = Σ_k a[m, k]·b[k, n]` with `b` contiguous in `n`, so there is one register-tiled [`Product`] with two ways to walk `a`. Everything
is kept in *panels* of 32 columns, one row after the other, so that all strides are known to the compiler. Activations and gradients are a
[`Matrix`]. Weights have 32 outputs to a panel, a row for each input and the bias as last row; they are `b` of the first product and `c` of
the third.

Every element is summed sequentially over `k` with fused multiply-adds into one accumulator, whichever tile it falls
in. Its bits therefore depend neither on the rows beside it nor on the instruction set, and a policy evaluated alone
equals the same policy evaluated in a minibatch.

Vector operations stand in functions marked `inline(always)`, never in closures: those would be compiled without the
instruction set that was found at run time, and cost ten times as much.
*/

use std::array;
use std::ops::{Deref, DerefMut};

use pulp::{Arch, Simd, WithSimd};

/// Number of columns of a panel.
pub const PANEL: usize = 32;

/// Number of floats in a cache line, and in the widest vector.
const LINE: usize = 16;

/// A row of a panel: [`PANEL`] columns.
pub type Row = [f32; PANEL];

/// A zero-initialised float array that starts on a cache line, so that a vector load never touches two lines.
#[derive(Debug)]
pub struct AlignedBuffer {
    storage: Vec<f32>,
    start: usize,
    len: usize,
}

impl AlignedBuffer {
    /// Allocates `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let storage = vec![0.0; len + LINE - 1];
        let start = storage.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE - 1);
        Self { storage, start, len }
    }

    /// Returns the rows, if the matrix is stored in panels.
    pub fn rows(&self) -> &[Row] {
        self.as_chunks().0
    }

    /// Returns the rows, if the matrix is stored in panels.
    pub fn rows_mut(&mut self) -> &mut [Row] {
        self.as_chunks_mut().0
    }
}

impl From<&[f32]> for AlignedBuffer {
    fn from(values: &[f32]) -> Self {
        let mut buffer = Self::zeros(values.len());
        buffer.copy_from_slice(values);
        buffer
    }
}

impl Deref for AlignedBuffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.storage[self.start..self.start + self.len]
    }
}

impl DerefMut for AlignedBuffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.storage[self.start..self.start + self.len]
    }
}

/// A matrix stored as panels, one after the other. Columns beyond those in use have no meaning.
#[derive(Debug)]
pub struct Matrix {
    rows: usize,
    values: AlignedBuffer,
}

impl Matrix {
    /// Allocates a matrix of zeros.
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { rows, values: AlignedBuffer::zeros(rows * columns.next_multiple_of(PANEL)) }
    }

    methods! {
        /// Returns the number of columns that fit into the panels.
        fn columns(&self) -> usize = self.values.len() / self.rows;
        /// Returns the panel that starts at column 32 · `index`.
        fn panel(&self, index: usize) -> &[Row] = &self.values.rows()[index * self.rows..][..self.rows];
        /// Iterates over the panels in order.
        fn panels(&self) -> impl Iterator<Item = &[Row]> = self.values.rows().chunks(self.rows);
        /// Iterates over the panels in order.
        fn panels_mut(&mut self) -> impl Iterator<Item = &mut [Row]> = self.values.rows_mut().chunks_mut(self.rows);
    }

    /// Writes the first columns of a row.
    pub fn set_row(&mut self, row: usize, values: &[f32]) {
        for (panel, values) in self.panels_mut().zip(values.chunks(PANEL)) {
            panel[row][..values.len()].copy_from_slice(values);
        }
    }

    /// Reads the first columns of a row.
    pub fn read_row(&self, row: usize, values: &mut [f32]) {
        for (panel, values) in self.panels().zip(values.chunks_mut(PANEL)) {
            values.copy_from_slice(&panel[row][..values.len()]);
        }
    }
}

/// The product `c[m, n] = finish(start(n) + Σ_k a[m, k]·b[k, n])`, where `b` and `c` are one panel each.
pub struct Product<'a> {
    /// Number of rows `m`; up to 32 with `a_transposed`.
    pub rows: usize,
    /// Number of columns `n` in use, up to 32.
    pub columns: usize,
    /// The stretches of the inner dimension `k`, in order.
    pub stretches: &'a [Stretch<'a>],
    /// True if `a` is stored as (k, m) rather than (m, k).
    pub a_transposed: bool,
    /// The start values and the final operation of the sums.
    pub ends: Ends<'a>,
    /// The result, shape (m, n).
    pub c: &'a mut [Row],
}

/// A stretch of consecutive `k` of a product, with the matching parts of `a` and `b`.
#[derive(Clone, Copy)]
pub struct Stretch<'a> {
    /// Left operand, one panel: shape (m, k) with up to 32 `k`, or shape (k, m).
    pub a: &'a [Row],
    /// Right operand, shape (k, n).
    pub b: &'a [Row],
}

/// The start values and the final operation of a product's sums.
pub enum Ends<'a> {
    /// Starts with the bias and ends with ELU if `elu` is set: a layer's output.
    Bias { bias: &'a Row, elu: bool },
    /// Starts with zero and ends with a factor ELU′, where `y`, shaped like `c`, is ELU's output: the loss gradient one
    /// layer further back.
    EluSlope { y: &'a [Row] },
    /// Starts with the content of `c`: the loss gradient by the weights.
    Add,
}

impl Product<'_> {
    /// Computes the product into `c`.
    #[inline(never)] // one copy of the kernels for all callers
    pub fn compute(self, arch: Arch) {
        arch.dispatch(self);
    }
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        if self.a_transposed {
            self.run::<S, true>(simd);
        } else {
            self.run::<S, false>(simd);
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn run<S: Simd, const A_T: bool>(&mut self, simd: S) {
        let mut column = 0;
        while column < self.columns {
            // As many sums as the registers hold beside the operands; 16 are enough to hide the latency of the sums.
            if self.columns - column < 2 * S::F32_LANES {
                self.strip::<S, A_T, 8, 1>(simd, column);
                column += S::F32_LANES;
            } else {
                if S::REGISTER_COUNT >= 32 {
                    self.strip::<S, A_T, 8, 2>(simd, column);
                } else {
                    self.strip::<S, A_T, 6, 2>(simd, column);
                }
                column += 2 * S::F32_LANES;
            }
        }
    }

    /// Computes all rows of `V` vectors of columns. If the rows do not divide, the last tile overlaps the one before if
    /// allowed.
    #[inline(always)]
    fn strip<S: Simd, const A_T: bool, const R: usize, const V: usize>(&mut self, simd: S, column: usize) {
        // Tiles that add to their content must not overlap.
        let may_overlap = self.rows >= R && !matches!(self.ends, Ends::Add);
        let mut row = 0;
        while row < self.rows {
            let left = self.rows - row;
            if left >= R || may_overlap {
                self.tile::<S, A_T, R, V>(simd, row.min(self.rows - R), column);
                row += R;
            } else if left >= 2 {
                self.tile::<S, A_T, 2, V>(simd, row, column);
                row += 2;
            } else {
                self.tile::<S, A_T, 1, V>(simd, row, column);
                row += 1;
            }
        }
    }

    /// Computes a tile of `R` rows and `V` vectors.
    #[inline(always)]
    fn tile<S: Simd, const A_T: bool, const R: usize, const V: usize>(&mut self, simd: S, row: usize, column: usize) {
        let mut sums = [[simd.splat_f32s(0.0); V]; R];
        for (i, sums) in sums.iter_mut().enumerate() {
            for (v, sum) in sums.iter_mut().enumerate() {
                *sum = self.start(simd, row + i, column + v * S::F32_LANES);
            }
        }
        for stretch in self.stretches {
            if A_T {
                for (a, b) in stretch.a.iter().zip(stretch.b) {
                    add_products::<S, R, V>(simd, &mut sums, array::from_fn(|i| a[row + i]), b, column);
                }
            } else {
                let a: &[Row; R] = stretch.a[row..].first_chunk().expect("as many rows as the product");
                // A whole panel is the rule, and its loop the faster one.
                if let Some((b, [])) = stretch.b.split_first_chunk::<PANEL>() {
                    for k in 0..PANEL {
                        add_products::<S, R, V>(simd, &mut sums, array::from_fn(|i| a[i][k]), &b[k], column);
                    }
                } else {
                    for (k, b) in stretch.b.iter().enumerate() {
                        add_products::<S, R, V>(simd, &mut sums, array::from_fn(|i| a[i][k]), b, column);
                    }
                }
            }
        }
        for (i, sums) in sums.into_iter().enumerate() {
            for (v, sum) in sums.into_iter().enumerate() {
                let column = column + v * S::F32_LANES;
                let value = self.finish(simd, row + i, column, sum);
                S::as_mut_simd_f32s(&mut self.c[row + i][column..][..S::F32_LANES]).0[0] = value;
            }
        }
    }

    #[inline(always)]
    fn start<S: Simd>(&self, simd: S, row: usize, column: usize) -> S::f32s {
        match self.ends {
            Ends::Bias { bias, .. } => load::<S>(&bias[column..]),
            Ends::EluSlope { .. } => simd.splat_f32s(0.0),
            Ends::Add => load::<S>(&self.c[row][column..]),
        }
    }

    #[inline(always)]
    fn finish<S: Simd>(&self, simd: S, row: usize, column: usize, sum: S::f32s) -> S::f32s {
        match self.ends {
            Ends::Bias { elu: true, .. } => elu(simd, sum),
            Ends::EluSlope { y } => simd.mul_f32s(sum, elu_slope(simd, load::<S>(&y[row][column..]))),
            Ends::Bias { elu: false, .. } | Ends::Add => sum,
        }
    }
}

/// Adds the outer product of `a` and the vectors of `b` from `column` on.
#[inline(always)]
fn add_products<S: Simd, const R: usize, const V: usize>(
    simd: S,
    sums: &mut [[S::f32s; V]; R],
    a: [f32; R],
    b: &Row,
    column: usize,
) {
    let b = S::as_simd_f32s(&b[column..][..V * S::F32_LANES]).0;
    for i in 0..R {
        let a = simd.splat_f32s(a[i]);
        for v in 0..V {
            sums[i][v] = simd.mul_add_f32s(a, b[v], sums[i][v]);
        }
    }
}

#[inline(always)]
fn load<S: Simd>(from: &[f32]) -> S::f32s {
    S::as_simd_f32s(&from[..S::F32_LANES]).0[0]
}

/// Computes ELU: `x` where positive, `eˣ − 1` elsewhere (also for NaN).
#[inline(always)]
fn elu<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let positive = simd.greater_than_f32s(x, simd.splat_f32s(0.0));
    simd.select_f32s(positive, x, exp_m1(simd, x))
}

/// Computes ELU′ from ELU's output: 1 where positive, `y + 1` elsewhere.
#[inline(always)]
fn elu_slope<S: Simd>(simd: S, y: S::f32s) -> S::f32s {
    let one = simd.splat_f32s(1.0);
    simd.select_f32s(simd.greater_than_f32s(y, simd.splat_f32s(0.0)), one, simd.add_f32s(y, one))
}

/// Computes `eˣ − 1` to about 1 ulp for `x ≤ 0`; the result for positive `x` has no meaning.
///
/// For `n = round(x / ln 2)` and `r = x − n ln 2` it is `2ⁿ (eʳ − 1) + (2ⁿ − 1)`. The polynomial is the minimax fit of
/// `(eʳ − 1 − r) / r²` on `|r| ≤ ln 2 / 2`, weighted to the least error of `eʳ` (Lawson's iteration).
#[inline(always)]
fn exp_m1<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    const C: [f32; 5] = [0.499_999_94, 0.166_665_21, 0.041_668_39, 0.008_368_717, 0.001_381_459_9];
    /// Constant whose addition leaves `n + 127`, the exponent field of `2ⁿ`, in the lowest bits.
    const ROUND: f32 = 12_582_912.0 + 127.0;

    // e⁻³⁰ − 1 is −1 already, and 2ⁿ stays a normal number. A comparison, not a maximum, so that NaN passes.
    let lowest = simd.splat_f32s(-30.0);
    let x = simd.select_f32s(simd.less_than_f32s(x, lowest), lowest, x);
    let biased = simd.mul_add_f32s(x, simd.splat_f32s(std::f32::consts::LOG2_E), simd.splat_f32s(ROUND));
    let n = simd.sub_f32s(biased, simd.splat_f32s(ROUND));
    let r = simd.mul_add_f32s(n, simd.splat_f32s(-std::f32::consts::LN_2), x);
    let exponent = simd.wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(biased), simd.splat_u32s(23));
    let scale = simd.transmute_f32s_u32s(exponent);

    let mut q = simd.splat_f32s(C[4]);
    for c in [C[3], C[2], C[1], C[0]] {
        q = simd.mul_add_f32s(q, r, simd.splat_f32s(c));
    }
    let p = simd.mul_add_f32s(simd.mul_f32s(r, r), q, r);
    simd.mul_add_f32s(scale, p, simd.sub_f32s(scale, simd.splat_f32s(1.0)))
}

/// Column sums of all stretches of `b`, added to `sums`: the loss gradient by the bias.
pub struct ColumnSums<'a> {
    /// The stretches, of which only `b` is used.
    pub stretches: &'a [Stretch<'a>],
    /// The sums, one for each column.
    pub sums: &'a mut Row,
}

impl WithSimd for ColumnSums<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for (i, total) in S::as_mut_simd_f32s(self.sums).0.iter_mut().enumerate() {
            let mut sum = *total;
            for stretch in self.stretches {
                for row in stretch.b {
                    sum = simd.add_f32s(sum, load::<S>(&row[i * S::F32_LANES..]));
                }
            }
            *total = sum;
        }
    }
}

/// The sum of squares `Σ x²`, in a fixed order.
pub struct SumOfSquares<'a>(pub &'a [f32]);

impl WithSimd for SumOfSquares<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let (lines, rest) = self.0.as_chunks::<LINE>();
        let mut sums = [0.0_f32; LINE];
        for line in lines {
            for i in 0..LINE {
                sums[i] += line[i] * line[i];
            }
        }
        let mut total = 0.0;
        for &x in rest {
            total += f64::from(x * x);
        }
        for sum in sums {
            total += f64::from(sum);
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Elu<'a>(&'a mut [f32]);

    impl WithSimd for Elu<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for x in S::as_mut_simd_f32s(self.0).0 {
                *x = elu(simd, *x);
            }
        }
    }

    fn elu_of(x: &[f32], arch: Arch) -> Vec<f32> {
        let mut y = AlignedBuffer::zeros(x.len().next_multiple_of(LINE));
        y[..x.len()].copy_from_slice(x);
        arch.dispatch(Elu(&mut y));
        y[..x.len()].to_vec()
    }

    #[test]
    fn elu_is_accurate_to_two_units_in_the_last_place() {
        // Every 1009th of the negative numbers from −0 through the subnormals to −∞.
        let x: Vec<f32> = (0x8000_0000..=0xff80_0000_u32).step_by(1009).map(f32::from_bits).collect();
        for (x, y) in x.iter().zip(elu_of(&x, Arch::new())) {
            let exact = f64::from(*x).exp_m1();
            let ulp = f64::from((exact as f32).abs().next_up() - (exact as f32).abs());
            assert!((f64::from(y) - exact).abs() <= 2.0 * ulp, "x = {x:e}: {y:e}, not {exact:e}");
        }
    }

    #[test]
    fn elu_keeps_what_is_positive_and_what_is_not_a_number() {
        let y = elu_of(&[0.0, 1e-30, 3.0, 200.0, f32::MAX, f32::INFINITY, f32::NAN], Arch::new());
        assert_eq!(y[..6], [0.0, 1e-30, 3.0, 200.0, f32::MAX, f32::INFINITY]);
        assert!(y[6].is_nan());
    }

    #[test]
    fn buffers_start_on_cache_lines() {
        for len in [0, 1, 16, 1000] {
            let buffer = AlignedBuffer::zeros(len);
            assert_eq!((buffer.as_ptr().addr() % 64, buffer.len()), (0, len));
        }
    }
}

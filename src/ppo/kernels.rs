/*!
The products and activations of the learner, in portable SIMD.

Three matrix products make up a training step of a linear layer: `y = x·Wᵀ + b`, `δx = δy·W` and `δWᵀ = xᵀ·δy`. All
three are the same sum `c[m, n] = Σ_k a[m, k]·b[k, n]` with `b` contiguous in `n`, so there is one register-tiled
[`product`] with two ways to walk `a`. Weights are kept as *panels*: 32 outputs wide, one row per input, the bias as
last row, which is `b` for the first product and `c` for the third.

Every element is summed sequentially over `k` with fused multiply-adds into one accumulator, whichever tile it falls
in. Its bits therefore depend neither on the rows beside it nor on the instruction set, and a policy evaluated alone
equals the same policy evaluated in a minibatch.
*/

use std::array;
use std::ops::{Deref, DerefMut};

use pulp::{Simd, WithSimd};

/// Outputs per weight panel.
pub const PANEL: usize = 32;

/// Floats in a cache line, and in the widest vector.
const LINE: usize = 16;

/// Columns that a matrix of `columns` takes once padded to whole vectors.
pub fn padded(columns: usize) -> usize {
    columns.next_multiple_of(LINE)
}

/// Distance between rows of a matrix of `columns`: an odd number of cache lines, so that a walk down a column does not
/// fall on a few sets of the cache only.
pub fn row_stride(columns: usize) -> usize {
    (columns.div_ceil(LINE) | 1) * LINE
}

/// Zeroed floats that start on a cache line: a vector load then never touches two lines.
#[derive(Debug)]
pub struct Buffer {
    storage: Vec<f32>,
    start: usize,
    len: usize,
}

impl Buffer {
    /// `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let storage = vec![0.0; len + LINE - 1];
        let start = storage.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE - 1);
        Self { storage, start, len }
    }
}

impl Deref for Buffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.storage[self.start..self.start + self.len]
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.storage[self.start..self.start + self.len]
    }
}

/// `y = f(x·Wᵀ + b)` for the outputs of one panel.
pub struct Forward<'a> {
    /// Rows of `x` and `y`.
    pub rows: usize,
    /// Shape (rows, inputs), rows `x_stride` apart.
    pub x: &'a [f32],
    /// See `x`.
    pub x_stride: usize,
    /// Shape (inputs + 1, width): weights, then the bias.
    pub panel: &'a [f32],
    /// Padded outputs in the panel.
    pub width: usize,
    /// Whether `f` is ELU rather than the identity.
    pub elu: bool,
    /// From the panel's first output on; shape (rows, width), rows `y_stride` apart.
    pub y: &'a mut [f32],
    /// See `y`.
    pub y_stride: usize,
}

impl WithSimd for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (weights, bias) = self.panel.split_at(self.panel.len() - self.width);
        let depth = weights.len() / self.width;
        let product = Product {
            rows: self.rows,
            columns: self.width,
            stretches: &[Stretch {
                depth,
                a: self.x,
                b: weights,
            }],
            a_stride: self.x_stride,
            b_stride: self.width,
        };
        product.run::<S, _, false>(simd, &BiasThenElu { bias, elu: self.elu }, self.y, self.y_stride);
    }
}

struct BiasThenElu<'a> {
    bias: &'a [f32],
    elu: bool,
}

impl Ends for BiasThenElu<'_> {
    #[inline(always)]
    fn start<S: Simd>(&self, _: S, column: usize) -> S::f32s {
        load::<S>(&self.bias[column..])
    }

    #[inline(always)]
    fn finish<S: Simd>(&self, simd: S, _: usize, _: usize, sum: S::f32s) -> S::f32s {
        if self.elu { elu(simd, sum) } else { sum }
    }
}

/// `δx = (δy·W)·ELU′`, the loss gradient one layer further back.
pub struct Backward<'a> {
    /// Rows of `δx`.
    pub rows: usize,
    /// One stretch for each panel: `a` = the panel's columns of `δy`, `b` = the panel's rows of `W`, shape
    /// (outputs, inputs).
    pub panels: &'a [Stretch<'a>],
    /// Distance between rows of `δy`.
    pub delta_stride: usize,
    /// Inputs of the layer.
    pub inputs: usize,
    /// Inputs of the layer, that is ELU outputs of the one before; shape (rows, inputs).
    pub x: &'a [f32],
    /// Shape (rows, inputs).
    pub delta_x: &'a mut [f32],
}

impl WithSimd for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let stride = row_stride(self.inputs);
        let product = Product {
            rows: self.rows,
            columns: padded(self.inputs),
            stretches: self.panels,
            a_stride: self.delta_stride,
            b_stride: stride,
        };
        product.run::<S, _, false>(simd, &TimesEluSlope { y: self.x, stride }, self.delta_x, stride);
    }
}

/// ELU′ follows from ELU's output: 1 where positive, `y + 1` elsewhere.
struct TimesEluSlope<'a> {
    y: &'a [f32],
    stride: usize,
}

impl Ends for TimesEluSlope<'_> {
    #[inline(always)]
    fn finish<S: Simd>(&self, simd: S, row: usize, column: usize, sum: S::f32s) -> S::f32s {
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let y = load::<S>(&self.y[row * self.stride + column..]);
        let slope = simd.select_f32s(simd.greater_than_f32s(y, zero), one, simd.add_f32s(y, one));
        simd.mul_f32s(sum, slope)
    }
}

/// `δWᵀ = xᵀ·δy` and `δb = Σ δy` for one panel.
pub struct Gradient<'a> {
    /// One stretch for each block of rows: `a` = `x`, `b` = the panel's columns of `δy`.
    pub blocks: &'a [Stretch<'a>],
    /// Distance between rows of `x`.
    pub x_stride: usize,
    /// Distance between rows of `δy`.
    pub delta_stride: usize,
    /// Padded outputs in the panel.
    pub width: usize,
    /// Shape (inputs + 1, width), as the panel itself.
    pub gradient: &'a mut [f32],
}

impl WithSimd for Gradient<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let weights = self.gradient.len() - self.width;
        let (weights, bias) = self.gradient.split_at_mut(weights);
        bias.fill(0.0);
        for block in self.blocks {
            for row in 0..block.depth {
                let delta = &block.b[row * self.delta_stride..][..self.width];
                bias.iter_mut().zip(delta).for_each(|(sum, x)| *sum += x);
            }
        }
        let product = Product {
            rows: weights.len() / self.width,
            columns: self.width,
            stretches: self.blocks,
            a_stride: self.x_stride,
            b_stride: self.delta_stride,
        };
        product.run::<S, _, true>(simd, &Plain, weights, self.width);
    }
}

struct Plain;

impl Ends for Plain {}

/// A stretch of `depth` consecutive `k` of a product's sum, with the parts of `a` and `b` that belong to it.
#[derive(Clone, Copy)]
pub struct Stretch<'a> {
    /// Number of `k`.
    pub depth: usize,
    /// Left operand.
    pub a: &'a [f32],
    /// Right operand, shape (depth, columns).
    pub b: &'a [f32],
}

/// What a product's sums begin and end with.
trait Ends {
    /// Start value of the sums of a vector of columns.
    #[inline(always)]
    fn start<S: Simd>(&self, simd: S, _column: usize) -> S::f32s {
        simd.splat_f32s(0.0)
    }

    /// What becomes of the finished sums of a vector of columns in a row.
    #[inline(always)]
    fn finish<S: Simd>(&self, _simd: S, _row: usize, _column: usize, sum: S::f32s) -> S::f32s {
        sum
    }
}

/// `c[m, n] = Σ_k a[m, k]·b[k, n]`.
struct Product<'a> {
    rows: usize,
    /// A multiple of [`LINE`].
    columns: usize,
    /// The inner dimension, in order.
    stretches: &'a [Stretch<'a>],
    a_stride: usize,
    b_stride: usize,
}

impl Product<'_> {
    /// Sets `c[m, n] = finish(start(n) + Σ_k …)`. `A_T`: `a` is stored as (k, m) rather than (m, k).
    #[inline(always)]
    fn run<S: Simd, E: Ends, const A_T: bool>(&self, simd: S, ends: &E, c: &mut [f32], c_stride: usize) {
        let mut column = 0;
        while column < self.columns {
            // Accumulators fill the register file but for the operands; 8 rows suffice where there are 32 registers.
            if self.columns - column < 2 * S::F32_LANES {
                self.strip::<S, E, A_T, 8, 1>(simd, column, ends, c, c_stride);
                column += S::F32_LANES;
            } else {
                if S::REGISTER_COUNT >= 32 {
                    self.strip::<S, E, A_T, 8, 2>(simd, column, ends, c, c_stride);
                } else {
                    self.strip::<S, E, A_T, 6, 2>(simd, column, ends, c, c_stride);
                }
                column += 2 * S::F32_LANES;
            }
        }
    }

    /// `V` vectors of columns, all rows. The last tile overlaps the one before where the rows do not divide.
    #[inline(always)]
    fn strip<S: Simd, E: Ends, const A_T: bool, const R: usize, const V: usize>(
        &self,
        simd: S,
        column: usize,
        ends: &E,
        c: &mut [f32],
        c_stride: usize,
    ) {
        let mut row = 0;
        while row < self.rows {
            if self.rows < R {
                self.tile::<S, E, A_T, 1, V>(simd, row, column, ends, c, c_stride);
                row += 1;
            } else {
                let first = row.min(self.rows - R);
                self.tile::<S, E, A_T, R, V>(simd, first, column, ends, c, c_stride);
                row += R;
            }
        }
    }

    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    fn tile<S: Simd, E: Ends, const A_T: bool, const R: usize, const V: usize>(
        &self,
        simd: S,
        row: usize,
        column: usize,
        ends: &E,
        c: &mut [f32],
        c_stride: usize,
    ) {
        let mut sums = [[simd.splat_f32s(0.0); V]; R];
        for v in 0..V {
            let start = ends.start(simd, column + v * S::F32_LANES);
            for sums in &mut sums {
                sums[v] = start;
            }
        }
        for stretch in self.stretches {
            if A_T {
                for k in 0..stretch.depth {
                    let a = &stretch.a[k * self.a_stride + row..][..R];
                    let b = &stretch.b[k * self.b_stride + column..];
                    add_products::<S, R, V>(simd, &mut sums, array::from_fn(|i| a[i]), b);
                }
            } else {
                let a: [&[f32]; R] = array::from_fn(|i| &stretch.a[(row + i) * self.a_stride..][..stretch.depth]);
                for k in 0..stretch.depth {
                    let b = &stretch.b[k * self.b_stride + column..];
                    add_products::<S, R, V>(simd, &mut sums, array::from_fn(|i| a[i][k]), b);
                }
            }
        }
        for (i, sums) in sums.into_iter().enumerate() {
            for (v, sum) in sums.into_iter().enumerate() {
                let column = column + v * S::F32_LANES;
                let out = &mut c[(row + i) * c_stride + column..][..S::F32_LANES];
                S::as_mut_simd_f32s(out).0[0] = ends.finish(simd, row + i, column, sum);
            }
        }
    }
}

/// Adds the outer product of `a` and the first vectors of `b`.
#[inline(always)]
fn add_products<S: Simd, const R: usize, const V: usize>(
    simd: S,
    sums: &mut [[S::f32s; V]; R],
    a: [f32; R],
    b: &[f32],
) {
    let b = S::as_simd_f32s(&b[..V * S::F32_LANES]).0;
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

/// `x` where positive, `eˣ − 1` elsewhere (also for NaN).
#[inline(always)]
fn elu<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let positive = simd.greater_than_f32s(x, simd.splat_f32s(0.0));
    simd.select_f32s(positive, x, exp_m1(simd, x))
}

/// `eˣ − 1` to about 1 ulp for `x ≤ 0`; meaningless above.
///
/// With `n = round(x / ln 2)` and `r = x − n ln 2` it is `2ⁿ (eʳ − 1) + (2ⁿ − 1)`. The polynomial is the minimax fit of
/// `(eʳ − 1 − r) / r²` on `|r| ≤ ln 2 / 2`, weighted to the least error of `eʳ` (Lawson's iteration).
#[inline(always)]
fn exp_m1<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    const C: [f32; 5] = [
        0.499_999_94,
        0.166_665_21,
        0.041_668_389,
        0.008_368_716_6,
        0.001_381_459_9,
    ];
    /// Adding it leaves `n + 127`, the exponent field of `2ⁿ`, in the lowest bits.
    const ROUND: f32 = 12_582_912.0 + 127.0;

    // e⁻³⁰ − 1 is −1 already, and 2ⁿ stays a normal number. A comparison, not a maximum, so that NaN passes.
    let lowest = simd.splat_f32s(-30.0);
    let x = simd.select_f32s(simd.less_than_f32s(x, lowest), lowest, x);
    let biased = simd.mul_add_f32s(x, simd.splat_f32s(std::f32::consts::LOG2_E), simd.splat_f32s(ROUND));
    let n = simd.sub_f32s(biased, simd.splat_f32s(ROUND));
    let r = simd.mul_add_f32s(n, simd.splat_f32s(-std::f32::consts::LN_2), x);
    let exponent = simd.wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(biased), simd.splat_u32s(23));
    let scale = simd.transmute_f32s_u32s(exponent);

    let q = C[..4].iter().rev().fold(simd.splat_f32s(C[4]), |q, &c| {
        simd.mul_add_f32s(q, r, simd.splat_f32s(c))
    });
    let p = simd.mul_add_f32s(simd.mul_f32s(r, r), q, r);
    simd.mul_add_f32s(scale, p, simd.sub_f32s(scale, simd.splat_f32s(1.0)))
}

/// `Σ x²`, in a fixed order.
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

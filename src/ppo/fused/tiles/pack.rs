//! Conversion of f32 rows to operands of the tile unit.

use std::arch::x86_64::{__m128i, __m512i};

use pulp::x86::V4;
use pulp::{Simd, cast, f32x16, u32x4, u32x16};

use super::unit::{Operand, Tile};

/// Sixteen numbers, each split into a sum of two bf16 numbers, in the upper half of their lanes.
#[derive(Clone, Copy)]
pub struct Split {
    large: u32x16,
    small: u32x16,
}

/// Returns the upper half of each lane.
#[inline(always)]
fn upper(simd: V4, x: u32x16) -> u32x16 {
    simd.and_u32s(x, simd.splat_u32s(0xffff_0000))
}

#[inline(always)]
fn round(simd: V4, x: f32x16) -> u32x16 {
    simd.wrapping_add_u32x16(cast(x), simd.splat_u32s(0x8000))
}

/// Splits numbers, rounding halves away from zero. With `PARTS` = 1, `small` is not used.
#[inline(always)]
pub fn split<const PARTS: usize>(simd: V4, x: f32x16) -> Split {
    let large = round(simd, x);
    let small = if PARTS == 1 { large } else { round(simd, simd.sub_f32s(x, cast(upper(simd, large)))) };
    Split { large, small }
}

/// Combines pairs of bf16 numbers, with `first` in the lower halves.
#[inline(always)]
fn pairs(simd: V4, first: u32x16, second: u32x16) -> u32x16 {
    let low: u32x16 = cast(simd.avx512f._mm512_srli_epi32::<16>(cast(first)));
    simd.or_u32s(low, upper(simd, second))
}

/// Writes pairs of `first` and `second` to row `row` of one half of an operand.
#[inline(always)]
pub fn put<const PARTS: usize>(
    simd: V4,
    operand: &mut Operand<PARTS>,
    (half, row): (usize, usize),
    first: Split,
    second: Split,
) {
    operand.0[0][half].0[row] = pairs(simd, first.large, second.large);
    if PARTS == 2 {
        operand.0[PARTS - 1][half].0[row] = pairs(simd, first.small, second.small);
    }
}

/// Reads the numbers written by [`put`].
#[inline(always)]
pub fn get(simd: V4, operand: &Operand<1>, (half, row): (usize, usize)) -> [f32x16; 2] {
    let pairs = operand.0[0][half].0[row];
    let first: u32x16 = cast(simd.avx512f._mm512_slli_epi32::<16>(cast(pairs)));
    [cast(first), cast(upper(simd, pairs))]
}

/// Exchanges rows and columns of every tile; pairs stay pairs.
#[inline(always)]
pub fn transpose<const PARTS: usize>(simd: V4, from: &Operand<PARTS>, to: &mut Operand<PARTS>) {
    for (from, to) in from.0.as_flattened().iter().zip(to.0.as_flattened_mut()) {
        transpose_tile(simd, from, to);
    }
}

/// Transposes a tile: quarters of rows first, then 4 × 4 blocks within them.
#[inline(always)]
fn transpose_tile(simd: V4, from: &Tile, to: &mut Tile) {
    let avx = simd.avx512f;
    for quarter in 0..4 {
        let (row0, row1) = (side_by_side(simd, from, 0, quarter), side_by_side(simd, from, 1, quarter));
        let (row2, row3) = (side_by_side(simd, from, 2, quarter), side_by_side(simd, from, 3, quarter));
        let (a, b) = (avx._mm512_unpacklo_epi32(row0, row1), avx._mm512_unpackhi_epi32(row0, row1));
        let (c, d) = (avx._mm512_unpacklo_epi32(row2, row3), avx._mm512_unpackhi_epi32(row2, row3));
        to.0[4 * quarter] = cast(avx._mm512_unpacklo_epi64(a, c));
        to.0[4 * quarter + 1] = cast(avx._mm512_unpackhi_epi64(a, c));
        to.0[4 * quarter + 2] = cast(avx._mm512_unpacklo_epi64(b, d));
        to.0[4 * quarter + 3] = cast(avx._mm512_unpackhi_epi64(b, d));
    }
}

/// Gathers one quarter of row `row` of each four rows.
#[inline(always)]
fn side_by_side(simd: V4, from: &Tile, row: usize, quarter: usize) -> __m512i {
    let avx = simd.avx512f;
    let joined = avx._mm512_castsi128_si512(piece(from, row, quarter));
    let joined = avx._mm512_inserti32x4::<1>(joined, piece(from, 4 + row, quarter));
    let joined = avx._mm512_inserti32x4::<2>(joined, piece(from, 8 + row, quarter));
    avx._mm512_inserti32x4::<3>(joined, piece(from, 12 + row, quarter))
}

#[inline(always)]
fn piece(from: &Tile, row: usize, quarter: usize) -> __m128i {
    let pieces: [u32x4; 4] = cast(from.0[row]);
    cast(pieces[quarter])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ppo::fused::tiles::unit::{SQUARE, TileUnit};

    type Rows = [[f32; 32]; 32];

    fn lanes(row: &[f32; 32], half: usize) -> f32x16 {
        cast(*row[16 * half..].first_chunk::<16>().unwrap())
    }

    fn left<const PARTS: usize>(simd: V4, a: &Rows) -> Operand<PARTS> {
        let mut operand = Operand::ZERO;
        for (m, row) in a.iter().enumerate() {
            let [first, second] = [0, 1].map(|half| split::<PARTS>(simd, lanes(row, half)));
            put(simd, &mut operand, (m / 16, m % 16), first, second);
        }
        operand
    }

    fn right<const PARTS: usize>(simd: V4, b: &Rows) -> Operand<PARTS> {
        let mut operand = Operand::ZERO;
        for k in 0..16 {
            for half in 0..2 {
                let [first, second] = [k, k + 16].map(|k| split::<PARTS>(simd, lanes(&b[k], half)));
                put(simd, &mut operand, (half, k), first, second);
            }
        }
        operand
    }

    fn check<const PARTS: usize>(unit: &mut TileUnit, scale: f32, error: f64) {
        let number = |i: usize, j: usize| scale * ((i * 37 + j * 23) % 31) as f32 - 7.0;
        let a: Rows = std::array::from_fn(|i| std::array::from_fn(|j| number(i, j)));
        let b: Rows = std::array::from_fn(|i| std::array::from_fn(|j| number(j, i + 5)));
        let (a_operand, b_operand) = (left::<PARTS>(unit.simd, &a), right::<PARTS>(unit.simd, &b));
        let mut sums = [f32::NAN; SQUARE];
        for (times, add) in [(1.0, false), (2.0, true)] {
            unit.product([(&a_operand, &b_operand)].into_iter(), &mut sums, add);
            for (m, row) in a.iter().enumerate() {
                for n in 0..32 {
                    let exact: f64 = (0..32).map(|k| f64::from(row[k]) * f64::from(b[k][n])).sum();
                    let sum = f64::from(sums[(m / 16 * 2 + n / 16) * 256 + m % 16 * 16 + n % 16]);
                    assert!((sum - times * exact).abs() <= error, "{m}, {n}: {sum}, not {times} times {exact}");
                }
            }
        }
    }

    #[test]
    fn products_are_exact_for_small_whole_numbers_and_close_for_others() {
        let Some(mut unit) = TileUnit::new() else { return };
        check::<1>(&mut unit, 1.0, 0.0);
        check::<2>(&mut unit, 1.0, 0.0);
        check::<1>(&mut unit, 1.234, 64.0);
        check::<2>(&mut unit, 1.234, 0.1);
    }

    #[test]
    fn what_was_put_comes_back_and_transposed_pairs_stay_pairs() {
        let Some(simd) = V4::try_new() else { return };
        // No more than eight bits, as many as bf16 has.
        let a: Rows = std::array::from_fn(|i| std::array::from_fn(|j| ((i * 37 + j * 23) % 251) as f32 / 64.0));
        let operand = left::<1>(simd, &a);
        let mut transposed = Operand::ZERO;
        transpose(simd, &operand, &mut transposed);
        for m in 0..32 {
            let [first, second] = get(simd, &operand, (m / 16, m % 16));
            assert_eq!([first, second], [lanes(&a[m], 0), lanes(&a[m], 1)]);
            // Row `k` now holds the pairs of column `k`.
            let [first, second]: [[f32; 16]; 2] = get(simd, &transposed, (m / 16, m % 16)).map(cast);
            for k in 0..16 {
                assert_eq!((first[k], second[k]), (a[m / 16 * 16 + k][m % 16], a[m / 16 * 16 + k][m % 16 + 16]));
            }
        }
    }
}

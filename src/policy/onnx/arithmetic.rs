//! Arithmetic of the operators: element-wise functions with broadcasting, matrix products, slices along an axis.

use super::Result;
use super::tensor::{Tensor, elements, strides};

/// Maximum number of multiplications in one matrix product: twice the largest layer.
const MAX_PRODUCT: usize = 1 << 23;

pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Computes `ln(1 + exp(x))`, which is NaN for NaN.
pub(super) fn softplus(x: f32) -> f32 {
    if x.is_nan() { x } else { x.max(0.0) + (-x.abs()).exp().ln_1p() }
}

/// Computes erf by Abramowitz and Stegun 7.1.26, whose error of 1.5e-7 is that of single precision.
pub(super) fn erf(x: f32) -> f32 {
    let size = f64::from(x.abs());
    let t = 1.0 / (1.0 + 0.327_591_1 * size);
    let series =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    ((1.0 - series * (-size * size).exp()).copysign(f64::from(x))) as f32
}

/// Resolves an axis or index, which counts from the end if it is negative.
pub(super) fn axis(index: i64, size: usize) -> Result<usize> {
    let from_start = if index < 0 { index.saturating_add(size as i64) } else { index };
    usize::try_from(from_start)
        .ok()
        .filter(|index| *index < size)
        .ok_or_else(|| format!("its axis {index} is beyond {size} dimensions").into())
}

/// Takes the slices `chosen` of a tensor along one axis.
pub(super) fn along(x: &Tensor, at: usize, chosen: &[usize]) -> Result<Tensor> {
    let mut shape = x.shape().to_vec();
    let size = std::mem::replace(&mut shape[at], chosen.len());
    let count = elements(&shape)?;
    let inner: usize = shape[at + 1..].iter().product();
    let outer: usize = shape[..at].iter().product();
    let mut indices = Vec::with_capacity(count);
    for block in 0..outer {
        for index in chosen {
            let start = (block * size + index) * inner;
            indices.extend(start..start + inner);
        }
    }
    x.pick(shape, &indices)
}

/// Iterates over all positions of a shape in row-major order.
pub(super) fn positions(shape: &[usize]) -> impl Iterator<Item = Vec<usize>> + use<> {
    let (own, shape) = (strides(shape), shape.to_vec());
    let count = shape.iter().product();
    (0..count).map(move |k| own.iter().zip(&shape).map(|(stride, size)| k / stride % size).collect())
}

/// Returns the broadcast shape of two inputs and, for each of its elements, the index in both.
pub(super) fn broadcast_indices(
    a: &[usize],
    b: &[usize],
) -> Result<(Vec<usize>, impl Iterator<Item = (usize, usize)> + use<>)> {
    let rank = a.len().max(b.len());
    let padded = |shape: &[usize]| [vec![1; rank - shape.len()], shape.to_vec()].concat();
    let (wide_a, wide_b) = (padded(a), padded(b));
    let size = |(left, right): (&usize, &usize)| match (*left, *right) {
        (left, right) if left == right => Some(left),
        (1, other) | (other, 1) => Some(other),
        _ => None,
    };
    let shape: Option<Vec<usize>> = wide_a.iter().zip(&wide_b).map(size).collect();
    let shape = shape.ok_or_else(|| format!("its inputs have the shapes {a:?} and {b:?}, which do not fit"))?;
    elements(&shape)?;
    let steps = |wide: &[usize]| -> Vec<usize> {
        strides(wide).iter().zip(wide).map(|(stride, size)| if *size == 1 { 0 } else { *stride }).collect()
    };
    let (steps_a, steps_b) = (steps(&wide_a), steps(&wide_b));
    let at = |position: &[usize], steps: &[usize]| position.iter().zip(steps).map(|(p, s)| p * s).sum::<usize>();
    let indices = positions(&shape).map(move |position| (at(&position, &steps_a), at(&position, &steps_b)));
    Ok((shape, indices))
}

/// Applies a function to the elements of two tensors; dimensions of size one are repeated.
pub(super) fn broadcast(a: &Tensor, b: &Tensor, function: impl Fn(f32, f32) -> f32) -> Result<Tensor> {
    let (left, right) = (a.floats()?, b.floats()?);
    // The usual cases at the speed of a loop: the same shape, a bias, a scalar.
    let repeats = a.shape().ends_with(b.shape()) || right.len() == 1 && b.shape().len() <= a.shape().len();
    if repeats && !right.is_empty() {
        let values = left.chunks(right.len()).flat_map(|row| row.iter().zip(right));
        return Tensor::float(a.shape().to_vec(), values.map(|(x, y)| function(*x, *y)).collect());
    }
    let (shape, indices) = broadcast_indices(a.shape(), b.shape())?;
    Tensor::float(shape, indices.map(|(i, j)| function(left[i], right[j])).collect())
}

/// Checks that a result has the shape of the tensor that it was computed from.
pub(super) fn fits(result: &Tensor, expected: &Tensor) -> Result<Tensor> {
    if result.shape() == expected.shape() {
        Ok(result.clone())
    } else {
        Err(format!("it has {:?} outputs, but parameters for {:?}", expected.shape(), result.shape()).into())
    }
}

/// Returns a matrix, transposed on request.
pub(super) fn matrix(tensor: &Tensor, transposed: bool) -> Result<Tensor> {
    let [rows, columns] = *tensor.shape() else {
        return Err(format!("its input has the shape {:?}, expected two dimensions", tensor.shape()).into());
    };
    if !transposed {
        return Ok(tensor.clone());
    }
    let values = tensor.floats()?;
    let at = |k: usize| values[k % rows * columns + k / rows];
    Tensor::float(vec![columns, rows], (0..rows * columns).map(at).collect())
}

/// Computes `A · Bᵀ`, where both have rows of the same length.
pub(super) fn multiply(a: &Tensor, b_transposed: &Tensor) -> Result<Tensor> {
    let ([rows, inner], [columns, width]) = (*two(a)?, *two(b_transposed)?);
    ensure!(inner == width, "it multiplies {inner} values with a matrix for {width}");
    if rows.saturating_mul(columns).saturating_mul(inner) > MAX_PRODUCT {
        return Err(format!("its product of {rows} x {inner} and {inner} x {columns} is too large for a policy").into());
    }
    // With an inner length of 0, the product of lengths bounds nothing: the shape is bounded here.
    let count = elements(&[rows, columns])?;
    let (left, right) = (a.floats()?, b_transposed.floats()?);
    let value = |k: usize| dot(&left[k / columns * inner..][..inner], &right[k % columns * inner..][..inner]);
    Tensor::float(vec![rows, columns], (0..count).map(value).collect())
}

fn two(tensor: &Tensor) -> Result<&[usize; 2]> {
    tensor.shape().try_into().map_err(|_| format!("its input has the shape {:?}", tensor.shape()).into())
}

/// Computes a dot product in eight parallel sums, which the compiler vectorises.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (x, y) in a.iter().zip(b) {
        for (sum, (x, y)) in sums.iter_mut().zip(x.iter().zip(y)) {
            *sum += x * y;
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    sums.iter().sum::<f32>() + rest
}

//! Dense tensors of the interpreter: single-precision values, or integers for shapes and indices.

use half::{bf16, f16};

use super::Result;
use super::proto::{self, BFLOAT16, DOUBLE, FLOAT, FLOAT16, INT32, INT64};

/// Maximum number of elements of a tensor: a layer of 2048 by 2048.
pub const MAX_ELEMENTS: usize = 1 << 22;

/// Maximum number of dimensions of a tensor.
const MAX_RANK: usize = 6;

/// Row-major values of a tensor.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Single-precision values, which networks compute with.
    Float(Vec<f32>),
    /// Integers: shapes, axes, indices.
    Int(Vec<i64>),
}

/// A tensor: values and their shape, whose product is their number.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    shape: Vec<usize>,
    values: Values,
}

impl Tensor {
    /// Creates a tensor of single-precision values.
    pub fn float(shape: Vec<usize>, values: Vec<f32>) -> Result<Self> {
        Self::new(shape, Values::Float(values))
    }

    /// Creates a tensor of integers.
    pub fn int(shape: Vec<usize>, values: Vec<i64>) -> Result<Self> {
        Self::new(shape, Values::Int(values))
    }

    /// Creates a tensor of either kind.
    pub fn new(shape: Vec<usize>, values: Values) -> Result<Self> {
        let count = elements(&shape)?;
        let found = match &values {
            Values::Float(values) => values.len(),
            Values::Int(values) => values.len(),
        };
        if found == count {
            Ok(Tensor { shape, values })
        } else {
            Err(format!("{found} values for the shape {shape:?}, which has {count}").into())
        }
    }

    /// Reads a constant of the file.
    pub fn read(tensor: &proto::TensorProto) -> Result<Self> {
        if tensor.data_location != 0 {
            return Err("its values are in another file, and it is no weight of the graph: save the model as one file, in PyTorch \
                        with torch.onnx.export(..., external_data=False)"
                .into());
        }
        let shape = tensor.dims.iter().map(|size| usize::try_from(*size));
        let shape: Vec<usize> =
            shape.collect::<std::result::Result<_, _>>().map_err(|_| format!("its shape is {:?}", tensor.dims))?;
        elements(&shape)?;
        let raw = &tensor.raw_data;
        let values = match tensor.data_type {
            FLOAT if raw.is_empty() => Values::Float(tensor.float_data.clone()),
            FLOAT => Values::Float(chunks::<4>(raw)?.map(f32::from_le_bytes).collect()),
            FLOAT16 => Values::Float(halves(tensor)?.map(|bits| f16::from_bits(bits).to_f32()).collect()),
            BFLOAT16 => Values::Float(halves(tensor)?.map(|bits| bf16::from_bits(bits).to_f32()).collect()),
            DOUBLE if raw.is_empty() => Values::Float(tensor.double_data.iter().map(|value| *value as f32).collect()),
            DOUBLE => Values::Float(chunks::<8>(raw)?.map(|bytes| f64::from_le_bytes(bytes) as f32).collect()),
            INT32 if raw.is_empty() => Values::Int(tensor.int32_data.iter().map(|value| i64::from(*value)).collect()),
            INT32 => Values::Int(chunks::<4>(raw)?.map(|bytes| i64::from(i32::from_le_bytes(bytes))).collect()),
            INT64 if raw.is_empty() => Values::Int(tensor.int64_data.clone()),
            INT64 => Values::Int(chunks::<8>(raw)?.map(i64::from_le_bytes).collect()),
            other => {
                return Err(format!(
                    "its element type is {other}, expected 1, 10, 11 or 16 (floating point), 6 or 7 (integers)"
                )
                .into());
            }
        };
        Self::new(shape, values)
    }

    methods! {
        /// Returns the size of each dimension.
        fn shape(&self) -> &[usize] = &self.shape;
        /// Returns the values of either kind.
        fn values(&self) -> &Values = &self.values;
        /// Returns the same values in another shape.
        fn reshaped(&self, shape: Vec<usize>) -> Result<Self> = Self::new(shape, self.values.clone());
    }

    /// Returns the values if they are single precision.
    pub fn floats(&self) -> Result<&[f32]> {
        match &self.values {
            Values::Float(values) => Ok(values),
            Values::Int(_) => Err("its input holds integers, expected single-precision numbers".into()),
        }
    }

    /// Returns the values if they are integers.
    pub fn ints(&self) -> Result<&[i64]> {
        match &self.values {
            Values::Int(values) => Ok(values),
            Values::Float(_) => Err("its input holds single-precision numbers, expected integers".into()),
        }
    }

    /// Applies a function to every value.
    pub fn map(&self, function: impl Fn(f32) -> f32) -> Result<Self> {
        Self::float(self.shape.clone(), self.floats()?.iter().map(|value| function(*value)).collect())
    }

    /// Picks elements by their index in this tensor, into a new shape.
    pub fn pick(&self, shape: Vec<usize>, indices: &[usize]) -> Result<Self> {
        fn of<T: Copy>(values: &[T], indices: &[usize]) -> Option<Vec<T>> {
            indices.iter().map(|index| values.get(*index).copied()).collect()
        }
        let values = match &self.values {
            Values::Float(values) => of(values, indices).map(Values::Float),
            Values::Int(values) => of(values, indices).map(Values::Int),
        };
        Self::new(shape, values.ok_or("an index is beyond the end of its input")?)
    }
}

/// Returns the number of elements of a shape. Its bound holds as if no dimension were empty: of a tensor without elements,
/// operators still go through the other dimensions, and [`strides`] multiplies them.
pub fn elements(shape: &[usize]) -> Result<usize> {
    let bound = shape.iter().try_fold(1_usize, |product, size| product.checked_mul((*size).max(1)));
    match bound {
        Some(bound) if bound <= MAX_ELEMENTS && shape.len() <= MAX_RANK => Ok(shape.iter().product()),
        _ => Err(format!("the shape {shape:?} is too large: at most {MAX_ELEMENTS} elements in {MAX_RANK} dimensions")
            .into()),
    }
}

/// Returns the distance in elements between neighbours along each dimension.
pub fn strides(shape: &[usize]) -> Vec<usize> {
    let mut strides = vec![1; shape.len()];
    for k in (1..shape.len()).rev() {
        strides[k - 1] = strides[k] * shape[k];
    }
    strides
}

/// Returns the bits of the half-precision values of a constant, which may be in the field of 32-bit integers.
fn halves(tensor: &proto::TensorProto) -> Result<impl Iterator<Item = u16>> {
    let raw = chunks::<2>(&tensor.raw_data)?.map(u16::from_le_bytes);
    Ok(raw.chain(tensor.int32_data.iter().map(|bits| *bits as u16)))
}

fn chunks<const N: usize>(raw: &[u8]) -> Result<impl Iterator<Item = [u8; N]>> {
    let (chunks, rest) = raw.as_chunks::<N>();
    if rest.is_empty() {
        Ok(chunks.iter().copied())
    } else {
        Err(format!("its {} bytes are no whole numbers", raw.len()).into())
    }
}

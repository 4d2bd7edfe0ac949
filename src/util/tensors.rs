/*! Safetensors files with one JSON text in addition to the tensors, for policies and checkpoints.

All metadata are under one key: the format keeps several in a hash map, whose order would change the file's bytes.
*/

use std::collections::HashMap;

use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::Deserialize;
use serde::de::DeserializeOwned;

/// Metadata key of the JSON text.
const KEY: &str = "supple";

/// Name, shape and values of a network's tensor.
pub type Named = (String, Vec<usize>, Vec<f32>);

/// A named tensor, little-endian.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Tensor {
    /// Creates a tensor from single precision, row-major.
    pub fn f32(name: impl Into<String>, shape: Vec<usize>, values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Tensor { name: name.into(), dtype: Dtype::F32, shape, bytes }
    }

    /// Creates tensors from the weights of a network, as [`crate::network::Mlp::tensors`] names them.
    pub fn of_network(tensors: Vec<(String, Vec<usize>, &[f32])>) -> Vec<Self> {
        tensors.into_iter().map(|(name, shape, values)| Self::f32(name, shape, values)).collect()
    }

    /// Creates a tensor from double precision, row-major.
    pub fn f64(name: impl Into<String>, shape: Vec<usize>, values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Tensor { name: name.into(), dtype: Dtype::F64, shape, bytes }
    }
}

/// Serialises tensors and a JSON text to the bytes of a file.
///
/// # Errors
/// A shape does not fit its values.
pub fn serialize(tensors: &[Tensor], json: String) -> Result<Vec<u8>, SafeTensorError> {
    let views: Result<Vec<_>, SafeTensorError> = tensors
        .iter()
        .map(|tensor| Ok((tensor.name.as_str(), TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes)?)))
        .collect();
    safetensors::serialize(views?, Some(HashMap::from([(KEY.to_owned(), json)])))
}

/// Reads the tensors and the JSON text of a file.
///
/// # Errors
/// The bytes are not a safetensors file with this metadata; the text says why.
pub fn deserialize(bytes: &[u8]) -> Result<(SafeTensors<'_>, String), String> {
    let broken = |error| format!("not a whole safetensors file ({error}); was it cut off while copying?");
    let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
    let json = header.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
    let json = json.ok_or_else(|| format!("it has no metadata '{KEY}': not written by supple"))?;
    Ok((tensors, json.clone()))
}

/// Parses the JSON text if its key `format` is a supported version, which is checked first.
///
/// # Errors
/// The version is not supported, or the JSON does not fit the type.
pub fn metadata<T: DeserializeOwned>(json: &str, format: u32) -> Result<T, String> {
    #[derive(Deserialize)]
    struct Format {
        format: u32,
    }
    let broken = |error| format!("its metadata do not parse: {error}");
    let found: Format = serde_json::from_str(json).map_err(broken)?;
    if found.format != format {
        let found = found.format;
        return Err(format!(
            "its format is {found}, this program reads {format}: use the version of Supple that wrote it"
        ));
    }
    serde_json::from_str(json).map_err(broken)
}

/// Reads a single-precision tensor of a known shape.
///
/// # Errors
/// The tensor is missing, has another type or shape, or a value that is not finite.
pub fn read_f32(tensors: &SafeTensors<'_>, name: &str, shape: &[usize]) -> Result<Vec<f32>, String> {
    let bytes = tensor_bytes(tensors, name, Dtype::F32, shape)?;
    finite(name, bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect(), f32::is_finite)
}

/// Reads all single-precision tensors whose names begin with `prefix`: the rest of the name, shape and values.
///
/// # Errors
/// A tensor has another type, or a value that is not finite.
pub fn read_group(tensors: &SafeTensors<'_>, prefix: &str) -> Result<Vec<Named>, String> {
    let mut named = Vec::new();
    for (name, view) in tensors.iter() {
        if let Some(rest) = name.strip_prefix(prefix) {
            named.push((rest.to_owned(), view.shape().to_vec(), read_f32(tensors, name, view.shape())?));
        }
    }
    Ok(named)
}

/// Reads a double-precision tensor of a known shape.
///
/// # Errors
/// The tensor is missing, has another type or shape, or a value that is not finite.
pub fn read_f64(tensors: &SafeTensors<'_>, name: &str, shape: &[usize]) -> Result<Vec<f64>, String> {
    let bytes = tensor_bytes(tensors, name, Dtype::F64, shape)?;
    finite(name, bytes.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(), f64::is_finite)
}

fn tensor_bytes<'a>(tensors: &SafeTensors<'a>, name: &str, dtype: Dtype, shape: &[usize]) -> Result<&'a [u8], String> {
    let view = tensors.tensor(name).map_err(|_| format!("it has no tensor {name}"))?;
    if view.dtype() != dtype || view.shape() != shape {
        let (found, kind) = (view.shape(), view.dtype());
        return Err(format!("its tensor {name} is {kind:?} {found:?}, expected {dtype:?} {shape:?}"));
    }
    Ok(view.data())
}

fn finite<T: Copy>(name: &str, values: Vec<T>, is_finite: fn(T) -> bool) -> Result<Vec<T>, String> {
    let all = values.iter().all(|value| is_finite(*value));
    if all { Ok(values) } else { Err(format!("its tensor {name} holds numbers that are not finite")) }
}

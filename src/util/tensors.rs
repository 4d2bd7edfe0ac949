/*! Safetensors files with one JSON text in addition to the tensors, for policies and checkpoints.

All metadata are under one key: the format keeps several in a hash map, whose order would change the file's bytes.
*/

use std::collections::HashMap;

use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::Deserialize;
use serde::de::{DeserializeOwned, Error as _};

use super::files;

/// Metadata key of the JSON text.
const KEY: &str = "supple";

/// Name, shape and values of a network's tensor.
pub type WeightTensor = (String, Vec<usize>, Vec<f32>);

/// A named tensor, little-endian.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredTensor {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl StoredTensor {
    /// Creates a tensor from single precision, row-major.
    pub fn f32(name: impl Into<String>, shape: Vec<usize>, values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        StoredTensor { name: name.into(), dtype: Dtype::F32, shape, bytes }
    }

    /// Creates tensors from the named weights of a network.
    pub fn of_network(tensors: Vec<(String, Vec<usize>, &[f32])>) -> Vec<Self> {
        tensors.into_iter().map(|(name, shape, values)| Self::f32(name, shape, values)).collect()
    }

    /// Creates a tensor from double precision, row-major.
    pub fn f64(name: impl Into<String>, shape: Vec<usize>, values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        StoredTensor { name: name.into(), dtype: Dtype::F64, shape, bytes }
    }

    /// Creates a tensor from bytes, for what is too long for the metadata: a file's header has at most 100 MB.
    pub fn u8(name: impl Into<String>, bytes: Vec<u8>) -> Self {
        StoredTensor { name: name.into(), dtype: Dtype::U8, shape: vec![bytes.len()], bytes }
    }
}

/// The reason why a file's tensors cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum TensorError {
    #[error("not a whole safetensors file ({0}); was it cut off while copying?")]
    Broken(#[from] SafeTensorError),
    #[error("it has no metadata '{KEY}': not written by supple")]
    Foreign,
    #[error("its metadata do not parse: {0}")]
    Metadata(#[from] serde_json::Error),
    #[error("its format is {found}, this program reads {expected}: use the version of Supple that wrote it")]
    Format { found: u32, expected: u32 },
    #[error("it has no tensor {0}")]
    Missing(String),
    #[error("its tensor {name} is {:?} {:?}, expected {:?} {:?}", found.0, found.1, expected.0, expected.1)]
    Shape { name: String, found: (Dtype, Vec<usize>), expected: (Dtype, Vec<usize>) },
    #[error("its tensor {0} holds numbers that are not finite")]
    NotFinite(String),
}

/// Serialises tensors and a JSON text to the bytes of a file.
pub fn serialize(tensors: &[StoredTensor], json: String) -> Result<Vec<u8>, SafeTensorError> {
    let views: Result<Vec<_>, SafeTensorError> = tensors
        .iter()
        .map(|tensor| Ok((tensor.name.as_str(), TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes)?)))
        .collect();
    safetensors::serialize(views?, Some(HashMap::from([(KEY.to_owned(), json)])))
}

/// Reads the tensors and the JSON text of a file.
pub fn deserialize(bytes: &[u8]) -> Result<(SafeTensors<'_>, String), TensorError> {
    let tensors = SafeTensors::deserialize(bytes)?;
    let (_, header) = SafeTensors::read_metadata(bytes)?;
    let json = header.metadata().as_ref().and_then(|metadata| metadata.get(KEY)).ok_or(TensorError::Foreign)?;
    Ok((tensors, json.clone()))
}

/// Parses the JSON text if its key `format` is a supported version, which is checked first.
pub fn metadata<T: DeserializeOwned>(json: &str, format: u32) -> Result<T, TensorError> {
    #[derive(Deserialize)]
    struct Format {
        format: u32,
    }
    let found: Format = serde_json::from_str(json)?;
    ensure!(found.format == format, TensorError::Format { found: found.format, expected: format });
    Ok(from_json(json.as_bytes())?)
}

/// Parses JSON that Supple wrote.
pub fn from_json<T: DeserializeOwned>(json: &[u8]) -> serde_json::Result<T> {
    let mut reader = serde_json::Deserializer::from_slice(json);
    let read = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let problem = files::of_another_version(&error.to_string());
        problem.map_or_else(|| error.into_inner(), serde_json::Error::custom)
    })?;
    reader.end()?;
    Ok(read)
}

/// Reads a single-precision tensor of a known shape.
pub fn read_f32(tensors: &SafeTensors<'_>, name: &str, shape: &[usize]) -> Result<Vec<f32>, TensorError> {
    let bytes = tensor_bytes(tensors, name, (Dtype::F32, shape))?;
    finite(name, bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect(), f32::is_finite)
}

/// Reads all single-precision tensors whose names begin with `prefix`: the rest of the name, shape and values.
pub fn read_group(tensors: &SafeTensors<'_>, prefix: &str) -> Result<Vec<WeightTensor>, TensorError> {
    let mut named = Vec::new();
    for (name, view) in tensors.iter() {
        if let Some(rest) = name.strip_prefix(prefix) {
            named.push((rest.to_owned(), view.shape().to_vec(), read_f32(tensors, name, view.shape())?));
        }
    }
    Ok(named)
}

/// Reads a double-precision tensor of a known shape.
pub fn read_f64(tensors: &SafeTensors<'_>, name: &str, shape: &[usize]) -> Result<Vec<f64>, TensorError> {
    let bytes = tensor_bytes(tensors, name, (Dtype::F64, shape))?;
    finite(name, bytes.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(), f64::is_finite)
}

/// Reads a tensor of bytes, of any length.
pub fn read_u8<'a>(tensors: &SafeTensors<'a>, name: &str) -> Result<&'a [u8], TensorError> {
    let length = tensors.tensor(name).map_or(0, |view| view.data().len());
    tensor_bytes(tensors, name, (Dtype::U8, &[length]))
}

fn tensor_bytes<'a>(tensors: &SafeTensors<'a>, name: &str, kind: (Dtype, &[usize])) -> Result<&'a [u8], TensorError> {
    let view = tensors.tensor(name).map_err(|_| TensorError::Missing(name.to_owned()))?;
    if (view.dtype(), view.shape()) != kind {
        let (found, expected) = ((view.dtype(), view.shape().to_vec()), (kind.0, kind.1.to_vec()));
        return Err(TensorError::Shape { name: name.to_owned(), found, expected });
    }
    Ok(view.data())
}

fn finite<T: Copy>(name: &str, values: Vec<T>, is_finite: fn(T) -> bool) -> Result<Vec<T>, TensorError> {
    let all = values.iter().all(|value| is_finite(*value));
    if all { Ok(values) } else { Err(TensorError::NotFinite(name.to_owned())) }
}

//! Weights in files beside an ONNX file, as `torch.onnx.export` writes them unless `external_data=False`.

use std::path::{Component, Path, PathBuf};

use super::proto::{Graph, Property};
use super::{Result, Unsupported};
use crate::util::files;

/// Maximum size of an ONNX file, and of the weights beside it \[bytes\].
pub const MAX_BYTES: u64 = 32 << 20;

/// Value of `data_location` of a constant in another file.
const EXTERNAL: i32 = 1;

/// Moves the values of other files in `folder` into the constants of a graph, and returns the files' bytes in the order in
/// which the graph names them.
pub fn read_beside(graph: &mut Graph, folder: &Path) -> Result<Vec<Vec<u8>>> {
    let mut read: Vec<(String, Vec<u8>)> = Vec::new();
    let mut left = MAX_BYTES as usize;
    for constant in graph.initializer.iter_mut().filter(|constant| constant.data_location == EXTERNAL) {
        let named = |problem: Unsupported| Unsupported(format!("constant '{}': {problem}", constant.name));
        let place = ExternalData::new(&constant.external_data).map_err(named)?;
        let known = read.iter().position(|(name, _)| *name == place.file);
        let index = match known {
            Some(index) => index,
            None => {
                let path = folder.join(inside(&place.file).map_err(named)?);
                let bytes = files::read_bounded(&path, MAX_BYTES).map_err(|error| {
                    named(Unsupported(format!(
                        "its values are in {}: {error}; put that file beside the network's, or save the model as one file, in \
                         PyTorch with torch.onnx.export(..., external_data=False)",
                        path.display()
                    )))
                })?;
                read.push((place.file.clone(), bytes));
                read.len() - 1
            }
        };
        let values = place.of(&read[index].1).map_err(named)?;
        // Constants may share bytes; their sum is bounded like a file.
        left = left.checked_sub(values.len()).ok_or_else(|| {
            named(Unsupported(format!("its values and those before it have more than {MAX_BYTES} bytes")))
        })?;
        constant.raw_data = values.to_vec();
        constant.data_location = 0;
    }
    Ok(read.into_iter().map(|(_, bytes)| bytes).collect())
}

/// Position of a constant's values in another file.
struct ExternalData {
    file: String,
    offset: usize,
    length: Option<usize>,
}

impl ExternalData {
    fn new(entries: &[Property]) -> Result<Self> {
        let text = |key: &str| entries.iter().find(|entry| entry.key == key).map(|entry| entry.value.as_str());
        let number = |key: &str| {
            let wrong =
                |text: &str| Unsupported(format!("the {key} of its values is '{text}', expected a number of bytes"));
            text(key).map(|text| text.parse::<usize>().map_err(|_| wrong(text))).transpose()
        };
        let file = text("location").ok_or("its values are in another file, which it does not name")?;
        Ok(ExternalData { file: file.to_owned(), offset: number("offset")?.unwrap_or(0), length: number("length")? })
    }

    /// Returns the values in the bytes of the file.
    fn of<'a>(&self, bytes: &'a [u8]) -> Result<&'a [u8]> {
        let rest = bytes.get(self.offset..);
        let values = rest.and_then(|rest| self.length.map_or(Some(rest), |length| rest.get(..length)));
        values.ok_or_else(|| {
            let ExternalData { file, offset, length } = self;
            let length = length.map_or_else(String::new, |length| format!(" of {length} bytes"));
            let found = bytes.len();
            format!("its values{length} at byte {offset} are beyond the end of {file}, which has {found}; is it of another model?")
                .into()
        })
    }
}

/// Returns the path of a file beside the network's or below it, and refuses every other.
fn inside(location: &str) -> Result<PathBuf> {
    let path = Path::new(location);
    let is_inside = path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if is_inside && path.file_name().is_some() {
        Ok(path.to_owned())
    } else {
        Err(format!("its values are in '{location}', expected a file beside the network's").into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::onnx::OnnxNetwork;

    fn fixture(file: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/onnx").join(file)
    }

    fn refusal(folder: &Path) -> String {
        OnnxNetwork::load(&folder.join("beside.onnx")).unwrap_err().to_string()
    }

    #[test]
    fn weights_that_are_missing_or_short_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::copy(fixture("beside.onnx"), folder.path().join("beside.onnx")).unwrap();
        let missing = refusal(folder.path());
        assert!(missing.contains("beside.weights") && missing.contains("external_data=False"), "{missing}");
        std::fs::write(folder.path().join("beside.weights"), [0; 10]).unwrap();
        let short = refusal(folder.path());
        assert!(short.contains("'weight'") && short.contains("which has 10"), "{short}");
        assert!(OnnxNetwork::from_bytes(&std::fs::read(fixture("beside.onnx")).unwrap(), Path::new("x")).is_err());
    }

    #[test]
    fn both_files_are_returned_to_identify_the_network() {
        let (_, files) = OnnxNetwork::load(&fixture("beside.onnx")).unwrap();
        let expected = ["beside.onnx", "beside.weights"].map(|file| std::fs::read(fixture(file)).unwrap());
        assert_eq!(files, expected);
    }

    #[test]
    fn only_files_beside_the_network_are_read() {
        for outside in ["/etc/passwd", "../w", "a/../../w", "", "."] {
            assert!(inside(outside).is_err(), "{outside}");
        }
        assert_eq!(inside("./data/w.bin").unwrap(), Path::new("./data/w.bin"));
    }

    #[test]
    fn constants_that_share_bytes_do_not_outgrow_a_file() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("w"), vec![0; 1 << 20]).unwrap();
        let place = [("location", "w"), ("offset", "0"), ("length", "1048576")];
        let property = |(key, value): (&str, &str)| Property { key: key.into(), value: value.into() };
        let constant = crate::policy::onnx::proto::TensorProto {
            data_location: EXTERNAL,
            external_data: place.map(property).into(),
            ..Default::default()
        };
        let mut graph = Graph { initializer: vec![constant; 33], ..Graph::default() };
        let error = read_beside(&mut graph, folder.path()).unwrap_err().to_string();
        assert!(error.contains("more than 33554432 bytes"), "{error}");
    }
}

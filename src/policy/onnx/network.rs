//! A network read from an ONNX file, evaluated with one observation at a time.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use prost::Message;

use super::operators::OperatorCall;
use super::proto::{Graph, ModelProto, Node, Size, ValueInfo};
use super::tensor::{Tensor, elements};
use super::weights::{self, MAX_BYTES};
use super::{Result, Unsupported, wire};
use crate::policy::pytorch;
use crate::util::files::{self, FileError};

/// Name of the file type in error messages.
const ONNX: &str = "ONNX file";

/// Supported versions of the operator set: those with the meaning that `operators` implements.
const OPERATOR_SETS: std::ops::RangeInclusive<i64> = 7..=22;

/// Maximum number of operators in a network.
const MAX_NODES: usize = 2000;

/// Maximum number of elements of all values together (64 MiB).
const MAX_TOTAL: usize = 1 << 24;

/// Index of the network's input among the values.
const INPUT: usize = 0;

/// An operator with the indices of its inputs and outputs among the values.
#[derive(Debug)]
struct Operation {
    node: Node,
    inputs: Vec<Option<usize>>,
    outputs: Vec<usize>,
}

/// A network with one input and one output.
#[derive(Debug)]
pub struct OnnxNetwork {
    input: String,
    input_shape: Vec<usize>,
    output_slot: usize,
    outputs: usize,
    steps: Vec<Operation>,
    /// Constants by index; `None` where a value depends on the observation.
    constants: Vec<Option<Tensor>>,
}

/// Values of an evaluation by [`OnnxNetwork::forward`]; each robot needs its own.
#[derive(Debug, Default)]
pub struct OnnxScratch(Vec<Option<Tensor>>);

/// Reads the metadata of an ONNX file: keys and values.
///
/// # Errors
/// The file cannot be read or is not an ONNX model.
pub fn metadata(path: &Path) -> std::result::Result<BTreeMap<String, String>, FileError> {
    let bytes = files::read_bounded(path, MAX_BYTES).map_err(FileError::of(ONNX, path))?;
    let model = decode(&bytes).map_err(FileError::of(ONNX, path))?;
    Ok(model.metadata_props.into_iter().map(|property| (property.key, property.value)).collect())
}

impl OnnxNetwork {
    /// Reads a file, and the files of weights beside it that it names, and evaluates the network once. Returns the network
    /// and the bytes of the files.
    ///
    /// # Errors
    /// A file cannot be read or is not an ONNX model, or an operator or shape is not supported; the error names it.
    pub fn load(path: &Path) -> std::result::Result<(Self, Vec<Vec<u8>>), FileError> {
        let fail = FileError::of(ONNX, path);
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(fail)?;
        let mut model = decode(&bytes).map_err(FileError::of(ONNX, path))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let graph = model.graph.as_mut();
        let beside = graph.map_or(Ok(Vec::new()), |graph| weights::read_beside(graph, folder));
        let beside = beside.map_err(FileError::of(ONNX, path))?;
        let network = Self::new(model).map_err(FileError::of(ONNX, path))?;
        Ok((network, [vec![bytes], beside].concat()))
    }

    /// Parses a file's bytes and evaluates the network once; `path` is for error messages.
    ///
    /// # Errors
    /// The bytes are not an ONNX model, have weights in other files, or an operator or shape is not supported; the error names
    /// it.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> std::result::Result<Self, FileError> {
        decode(bytes).and_then(Self::new).map_err(FileError::of(ONNX, path))
    }

    fn new(model: ModelProto) -> Result<Self> {
        let versions = model.opset_import.iter().filter(|set| matches!(set.domain.as_str(), "" | "ai.onnx"));
        let version =
            versions.map(|set| set.version).max().ok_or("it does not say which operator set it is made of")?;
        if !OPERATOR_SETS.contains(&version) {
            let (first, last) = (OPERATOR_SETS.start(), OPERATOR_SETS.end());
            return Err(format!(
                "its operator set is {version}, expected {first} to {last}; export it with another one"
            )
            .into());
        }
        let graph = model.graph.ok_or("it has no graph")?;
        if graph.node.len() > MAX_NODES {
            return Err(format!("it has {} operators, at most {MAX_NODES} are expected", graph.node.len()).into());
        }
        let input = only_input(&graph)?.clone();
        let input_shape = shape_of(&input)?;
        let mut slots = HashMap::from([(input.name.clone(), INPUT)]);
        let mut constants: Vec<Option<Tensor>> = vec![None];
        for constant in &graph.initializer {
            let tensor =
                Tensor::read(constant).map_err(|problem| format!("constant '{}': {problem}", constant.name))?;
            slots.insert(constant.name.clone(), constants.len());
            constants.push(Some(tensor));
        }
        let mut values = vec![None; constants.len()];
        values[INPUT] = Some(Tensor::float(input_shape.clone(), vec![0.0; elements(&input_shape)?])?);
        // Constants are no larger than the file; what is computed from them may be.
        let (mut steps, mut total) = (Vec::new(), 0);
        for (index, node) in graph.node.into_iter().enumerate() {
            let title = title(index, &node);
            let named = |problem: Unsupported| Unsupported(format!("{title}: {problem}"));
            let step = Operation::new(node, &mut slots, &mut constants).map_err(named)?;
            values.resize(constants.len(), None);
            let changes = step.inputs.iter().flatten().any(|slot| values[*slot].is_some());
            let is_constant = !changes || step.node.op_type == "Shape";
            step.evaluate(&constants, &mut values).map_err(named)?;
            let sizes = step.outputs.iter().filter_map(|slot| values[*slot].as_ref());
            total += sizes.map(|value| value.shape().iter().product::<usize>()).sum::<usize>();
            if total > MAX_TOTAL {
                return Err(named(format!("its values and those before it are more than {MAX_TOTAL}").into()));
            }
            if is_constant {
                // Computed once, here.
                step.outputs.iter().for_each(|slot| constants[*slot] = values[*slot].take());
            } else {
                steps.push(step);
            }
        }
        let [output] = &graph.output[..] else {
            return Err(
                format!("it has {} outputs ({}), expected one", graph.output.len(), names(&graph.output)).into()
            );
        };
        let output_slot = *slots.get(&output.name).ok_or_else(|| format!("no operator computes '{}'", output.name))?;
        let mut network = OnnxNetwork { input: input.name, input_shape, output_slot, outputs: 0, steps, constants };
        network.outputs = network.output(&values)?.len();
        Ok(network)
    }

    methods! {
        /// Returns the name of the input.
        fn input_name(&self) -> &str = &self.input;
        /// Returns the number of inputs.
        fn inputs(&self) -> usize = self.input_shape.iter().product();
        /// Returns the number of outputs.
        fn outputs(&self) -> usize = self.outputs;
    }

    /// Evaluates the network. Start with [`OnnxScratch::default`], and use a scratch for one network only.
    ///
    /// # Panics
    /// `observation` has another length than [`OnnxNetwork::inputs`].
    pub fn forward<'a>(&self, observation: &[f32], scratch: &'a mut OnnxScratch) -> &'a [f32] {
        assert_eq!(observation.len(), self.inputs(), "the observation must have the input's length");
        scratch.0.resize(self.constants.len(), None);
        let whole = Tensor::float(self.input_shape.clone(), observation.to_vec()).and_then(|input| {
            scratch.0[INPUT] = Some(input);
            self.steps.iter().try_for_each(|step| step.evaluate(&self.constants, &mut scratch.0))
        });
        // Shapes and types do not depend on the observation, and reading the file evaluated it once.
        whole.and_then(|()| self.output(&scratch.0)).expect("a network that was evaluated once can be evaluated again")
    }

    fn output<'a>(&self, values: &'a [Option<Tensor>]) -> Result<&'a [f32]> {
        let output = values[self.output_slot].as_ref();
        output.ok_or("its output does not depend on its input")?.floats()
    }
}

impl Operation {
    /// Assigns an index to every input and output of a node.
    fn new(node: Node, slots: &mut HashMap<String, usize>, constants: &mut Vec<Option<Tensor>>) -> Result<Self> {
        let place = |name: &String| match slots.get(name) {
            Some(slot) => Ok(Some(*slot)),
            None if name.is_empty() => Ok(None),
            None => Err(format!("its input '{name}' is not computed before it").into()),
        };
        let inputs = node.input.iter().map(place).collect::<Result<Vec<_>>>()?;
        let outputs: Vec<usize> = (constants.len()..constants.len() + node.output.len()).collect();
        for (name, slot) in node.output.iter().zip(&outputs) {
            slots.insert(name.clone(), *slot);
        }
        constants.resize(constants.len() + node.output.len(), None);
        Ok(Operation { node, inputs, outputs })
    }

    /// Runs the operator on constants and on values that depend on the observation. Outputs that the node does not name
    /// are dropped.
    fn evaluate(&self, constants: &[Option<Tensor>], values: &mut [Option<Tensor>]) -> Result<()> {
        let value = |slot: usize| values[slot].as_ref().or(constants[slot].as_ref());
        let inputs: Vec<Option<&Tensor>> = self.inputs.iter().map(|slot| slot.and_then(value)).collect();
        if inputs.iter().zip(&self.inputs).any(|(value, slot)| value.is_none() && slot.is_some()) {
            return Err("one of its inputs is an output that is not supported".into());
        }
        let outputs = OperatorCall { node: &self.node, inputs: &inputs }.evaluate()?;
        for (slot, output) in self.outputs.iter().zip(outputs) {
            values[*slot] = Some(output);
        }
        Ok(())
    }
}

/// Decodes a file whose size has been checked.
fn decode(bytes: &[u8]) -> Result<ModelProto> {
    ensure!(!pytorch::is_pytorch(bytes), pytorch::ADVICE);
    wire::check(bytes)?;
    Ok(ModelProto::decode(bytes).map_err(|error| format!("not ONNX ({error})"))?)
}

/// Finds the one input that is not a constant; older files list constants as inputs, too.
fn only_input(graph: &Graph) -> Result<&ValueInfo> {
    let constant = |input: &&ValueInfo| graph.initializer.iter().any(|constant| constant.name == input.name);
    let inputs: Vec<&ValueInfo> = graph.input.iter().filter(|input| !constant(input)).collect();
    match inputs[..] {
        [input] => Ok(input),
        _ => {
            let names = inputs.iter().map(|input| input.name.as_str()).collect::<Vec<_>>().join(", ");
            Err(format!(
                "it has {} inputs ({names}), expected one, the observation; recurrent policies cannot be run",
                inputs.len()
            )
            .into())
        }
    }
}

/// Returns the input's shape for one observation; open dimensions become 1.
fn shape_of(input: &ValueInfo) -> Result<Vec<usize>> {
    let name = &input.name;
    let shape = input.kind.as_ref().and_then(|kind| kind.tensor_type.as_ref()).and_then(|kind| kind.shape.as_ref());
    let dimensions = &shape.ok_or_else(|| format!("its input '{name}' has no shape"))?.dim;
    let size = |(index, dimension): (usize, &super::proto::Dimension)| match dimension.size {
        Some(Size::Value(size)) if size > 0 => Ok(size as usize),
        _ if index + 1 < dimensions.len() => Ok(1),
        _ => Err(format!("the last dimension of its input '{name}' is open, expected the observation's length").into()),
    };
    let shape = dimensions.iter().enumerate().map(size).collect::<Result<Vec<_>>>()?;
    let count = elements(&shape)?;
    if count == 0 || shape.last() != Some(&count) {
        return Err(format!("its input '{name}' has the shape {shape:?}, expected (1, N): one observation").into());
    }
    Ok(shape)
}

/// Describes an operator for error messages by its index, type and name.
fn title(index: usize, node: &Node) -> String {
    match node.name.as_str() {
        "" => format!("operator {index}, {}", node.op_type),
        name => format!("operator {index}, {} '{name}'", node.op_type),
    }
}

fn names(values: &[ValueInfo]) -> String {
    values.iter().map(|value| value.name.as_str()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::onnx::export::{node, value_info};
    use crate::policy::onnx::proto::{FLOAT, INT64, OperatorSet, TensorProto};

    #[derive(serde::Deserialize)]
    struct Golden {
        file: String,
        inputs: Vec<Vec<f32>>,
        outputs: Vec<Vec<f32>>,
    }

    fn path(file: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/onnx").join(file)
    }

    fn fixture(file: &str) -> Vec<u8> {
        std::fs::read(path(file)).unwrap()
    }

    #[test]
    fn networks_agree_with_onnxruntime() {
        let golden: Vec<Golden> = serde_json::from_slice(&fixture("golden.json")).unwrap();
        assert_eq!(golden.len(), 5);
        for Golden { file, inputs, outputs } in golden {
            let (network, _) = OnnxNetwork::load(&path(&file)).unwrap();
            let mut scratch = OnnxScratch::default();
            for (input, expected) in inputs.iter().zip(&outputs) {
                let found = network.forward(input, &mut scratch);
                assert_eq!(found.len(), expected.len(), "{file}");
                for (index, (found, expected)) in found.iter().zip(expected).enumerate() {
                    let tolerance = 2e-6 * expected.abs().max(1.0);
                    assert!((found - expected).abs() <= tolerance, "{file}, output {index}: {found} {expected}");
                }
            }
        }
    }

    fn constant(name: &str, dims: &[i64], values: Vec<f32>) -> TensorProto {
        let dims = dims.to_vec();
        TensorProto { dims, data_type: FLOAT, float_data: values, name: name.into(), ..TensorProto::default() }
    }

    fn file(graph: Graph) -> Vec<u8> {
        let opset_import = vec![OperatorSet { domain: String::new(), version: 17 }];
        ModelProto { ir_version: 8, graph: Some(graph), opset_import, ..ModelProto::default() }.encode_to_vec()
    }

    fn graph(node: Vec<Node>, initializer: Vec<TensorProto>) -> Graph {
        let (input, output) = (vec![value_info("obs", 3, "")], vec![value_info("y", 2, "")]);
        Graph { node, initializer, input, output, ..Graph::default() }
    }

    fn refusal(graph: Graph) -> String {
        OnnxNetwork::from_bytes(&file(graph), Path::new("test.onnx")).unwrap_err().to_string()
    }

    #[test]
    fn what_cannot_be_run_is_named() {
        let unknown = refusal(graph(vec![node("Softmax", &["obs"], "y")], vec![]));
        assert!(unknown.contains("operator 0, Softmax: the operator Softmax is not supported"), "{unknown}");
        let weight = constant("w", &[4, 2], vec![0.0; 8]);
        let misfit = refusal(graph(vec![node("MatMul", &["obs", "w"], "y")], vec![weight]));
        assert!(misfit.contains("multiplies 3 values with a matrix for 4"), "{misfit}");
        let open = refusal(graph(vec![node("Relu", &["nowhere"], "y")], vec![]));
        assert!(open.contains("its input 'nowhere' is not computed before it"), "{open}");
        let short = refusal(graph(vec![], vec![constant("w", &[4, 2], vec![0.0; 7])]));
        assert!(short.contains("constant 'w': 7 values for the shape [4, 2]"), "{short}");
        let mut two = graph(vec![node("Relu", &["obs"], "y")], vec![]);
        two.input.push(value_info("hidden", 8, ""));
        assert!(refusal(two).contains("2 inputs (obs, hidden), expected one"));
        let mut still = graph(vec![], vec![constant("y", &[1, 2], vec![1.0; 2])]);
        still.node.push(node("Relu", &["obs"], "unused"));
        assert!(refusal(still).contains("does not depend on its input"));
    }

    #[test]
    fn small_files_that_would_grow_are_refused() {
        // A shape of 2⁶² elements.
        let huge = refusal(graph(vec![], vec![constant("w", &[1 << 31, 1 << 31], vec![])]));
        assert!(huge.contains("too large"), "{huge}");
        // Shapes without an element: one with 2⁶² rows to go through, one whose strides overflow.
        for shape in [&[1_i64 << 62, 0][..], &[0, 1 << 40, 1 << 40]] {
            let refused = refusal(graph(vec![], vec![constant("w", shape, vec![])]));
            assert!(refused.contains("too large"), "{refused}");
        }
        // Outer sums of 2000 numbers, again and again.
        let (row, column) =
            (constant("row", &[1, 2000], vec![0.0; 2000]), constant("column", &[2000, 1], vec![0.0; 2000]));
        let sums = (0..100).map(|index| node("Add", &["row", "column"], &format!("sum {index}"))).collect();
        let refused = refusal(graph(sums, vec![row, column]));
        assert!(refused.contains("more than 16777216"), "{refused}");
        let (int64_data, name) = (vec![i64::MAX, -1], "shape".into());
        let reshape = TensorProto { data_type: INT64, int64_data, name, dims: vec![2], ..TensorProto::default() };
        let refused = refusal(graph(vec![node("Reshape", &["obs", "shape"], "y")], vec![reshape]));
        assert!(refused.contains("too large"), "{refused}");
        // A product of matrices without a value in them.
        let (tall, wide) = (constant("tall", &[1 << 20, 0], vec![]), constant("wide", &[0, 1 << 20], vec![]));
        let refused = refusal(graph(vec![node("MatMul", &["tall", "wide"], "y")], vec![tall, wide]));
        assert!(refused.contains("too large"), "{refused}");
    }

    #[test]
    fn every_truncation_is_refused_or_runs() {
        let bytes = fixture("operators.onnx");
        for length in 0..bytes.len() {
            if let Ok(network) = OnnxNetwork::from_bytes(&bytes[..length], Path::new("cut")) {
                network.forward(&vec![0.5; network.inputs()], &mut OnnxScratch::default());
            }
        }
    }
}

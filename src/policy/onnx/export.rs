/*! Export of a policy to ONNX, for every other runtime.

One graph maps the raw observation (`observation`, shape (batch, observation), in its units) to the joint targets
(`joint_target`, shape (batch, 12), rad): it contains the normaliser and the action's scale and nominal pose, so that
users need not know them. The policy file's metadata are in `metadata_props`.
*/

use prost::Message;

use super::proto::{
    ATTRIBUTE_FLOAT, ATTRIBUTE_INT, Attribute, Dimension, FLOAT, Graph, ModelProto, Node, OperatorSet, Property, Size,
    TensorProto, TensorShapeProto, TensorType, Type, ValueInfo,
};
use crate::network::Layer;
use crate::policy::Policy;

/// ONNX IR version of the file; every runtime since 2022 supports it.
const IR_VERSION: i64 = 8;

/// Operator set; `Gemm`, `Elu`, `Sub`, `Mul`, `Add`, `Min` and `Max` have not changed since.
const OPSET: i64 = 17;

/// Exports the policy to the bytes of an ONNX file.
pub fn export(policy: &Policy) -> Vec<u8> {
    let mut builder = Builder::default();
    let single = |values: &[f64]| values.iter().map(|value| *value as f32).collect::<Vec<f32>>();
    let (inputs, outputs) = (policy.layout().length(), policy.nominal_pose().len());

    builder.constant("normaliser.offset", &[inputs], &single(policy.layout().offset()));
    builder.constant("normaliser.scale", &[inputs], &single(policy.layout().scale()));
    builder.node("Sub", &["observation", "normaliser.offset"], "centred", Vec::new());
    builder.node("Mul", &["centred", "normaliser.scale"], "normalised", Vec::new());
    let mut value = "normalised".to_owned();
    if policy.layout().clips() {
        for (operator, name, sign) in [("Min", "at_most", 1.0), ("Max", "at_least", -1.0)] {
            let limits: Vec<f32> = policy.layout().clip().iter().map(|clip| sign * *clip as f32).collect();
            builder.constant(&format!("normaliser.{name}"), &[inputs], &limits);
            builder.node(operator, &[&value, &format!("normaliser.{name}")], name, Vec::new());
            value = name.to_owned();
        }
    }
    for (index, layer) in policy.actor.layers.iter().enumerate() {
        value = builder.dense(index, layer, &value);
        if index + 1 < policy.actor.layers.len() {
            let activated = format!("elu.{index}");
            builder.node("Elu", &[&value], &activated, vec![float("alpha", 1.0)]);
            value = activated;
        }
    }
    builder.constant("action.scale", &[1], &single(&[policy.scale_rad()]));
    builder.constant("action.nominal_pose", &[outputs], &single(policy.nominal_pose()));
    builder.node("Mul", &[&value, "action.scale"], "offset_from_nominal", Vec::new());
    builder.node("Add", &["offset_from_nominal", "action.nominal_pose"], "joint_target", Vec::new());

    let graph = Graph {
        node: builder.nodes,
        name: "policy".into(),
        initializer: builder.constants,
        input: vec![value_info("observation", inputs, "raw observation, see the metadata for its layout and units")],
        output: vec![value_info("joint_target", outputs, "joint targets for the PD controller [rad]")],
    };
    let model = ModelProto {
        ir_version: IR_VERSION,
        producer_name: "supple".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        doc_string: "raw observation to joint targets: scales by itself, unlike the network in the metadata's `usage`"
            .into(),
        graph: Some(graph),
        opset_import: vec![OperatorSet { domain: String::new(), version: OPSET }],
        metadata_props: vec![Property { key: "supple".into(), value: policy.metadata_json() }],
    };
    model.encode_to_vec()
}

#[derive(Default)]
struct Builder {
    nodes: Vec<Node>,
    constants: Vec<TensorProto>,
}

impl Builder {
    fn constant(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        let (dims, name) = (shape.iter().map(|size| *size as i64).collect(), name.into());
        let raw_data = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.constants.push(TensorProto { dims, data_type: FLOAT, name, raw_data, ..TensorProto::default() });
    }

    fn node(&mut self, op_type: &str, inputs: &[&str], output: &str, attribute: Vec<Attribute>) {
        self.nodes.push(Node { name: output.into(), attribute, ..node(op_type, inputs, output) });
    }

    /// Adds a layer `y = x · Wᵀ + b` and returns the name of `y`.
    fn dense(&mut self, index: usize, layer: &Layer, input: &str) -> String {
        let (weight, bias) = (format!("policy.{index}.weight"), format!("policy.{index}.bias"));
        self.constant(&weight, &[layer.outputs(), layer.inputs()], &layer.weight);
        self.constant(&bias, &[layer.outputs()], &layer.bias);
        let output = format!("dense.{index}");
        let transposed = Attribute { name: "transB".into(), i: 1, kind: ATTRIBUTE_INT, ..Attribute::default() };
        self.node("Gemm", &[input, &weight, &bias], &output, vec![transposed]);
        output
    }
}

/// Creates a node without a name and attributes.
pub(super) fn node(op_type: &str, inputs: &[&str], output: &str) -> Node {
    let input = inputs.iter().map(ToString::to_string).collect();
    Node { op_type: op_type.into(), input, output: vec![output.into()], ..Node::default() }
}

fn float(name: &str, value: f32) -> Attribute {
    Attribute { name: name.into(), f: value, kind: ATTRIBUTE_FLOAT, ..Attribute::default() }
}

/// Describes a tensor of `width` columns and any number of rows.
pub(super) fn value_info(name: &str, width: usize, doc: &str) -> ValueInfo {
    let dim =
        vec![Dimension { size: Some(Size::Name("batch".into())) }, Dimension { size: Some(Size::Value(width as i64)) }];
    let tensor_type = Some(TensorType { elem_type: FLOAT, shape: Some(TensorShapeProto { dim }) });
    ValueInfo { name: name.into(), kind: Some(Type { tensor_type }), doc_string: doc.into() }
}

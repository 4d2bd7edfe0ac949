//! The part of ONNX's protobuf schema (onnx.proto, IR version 8) that networks of dense layers need, declared by hand so
//! that the build needs no protoc. Field numbers are the schema's; fields that are not declared are skipped in reading.

use prost::Message;

/// Element types of a tensor.
pub const FLOAT: i32 = 1;
pub const INT32: i32 = 6;
pub const INT64: i32 = 7;
pub const FLOAT16: i32 = 10;
pub const DOUBLE: i32 = 11;
pub const BFLOAT16: i32 = 16;

/// Kinds of an attribute.
pub const ATTRIBUTE_FLOAT: i32 = 1;
pub const ATTRIBUTE_INT: i32 = 2;

/// Declares messages: number, name and Rust type of each field, and its type in the schema.
macro_rules! messages {
    ($($(#[$doc:meta])* $Name:ident {
        $($(#[$note:meta])* $tag:literal $field:ident: $type:ty, $($kind:ident $(= $of:tt)?),+;)*
    })*) => {
        $($(#[$doc])* #[derive(Clone, PartialEq, Message)] pub struct $Name {
            $($(#[$note])* #[prost($($kind $(= $of)?),+, tag = $tag)] pub $field: $type,)*
        })*
    };
}

messages! {
    /// An ONNX model: the content of a file.
    ModelProto {
        1 ir_version: i64, int64;
        2 producer_name: String, string;
        3 producer_version: String, string;
        6 doc_string: String, string;
        7 graph: Option<Graph>, message, optional;
        8 opset_import: Vec<OperatorSet>, message, repeated;
        14 metadata_props: Vec<Property>, message, repeated;
    }

    /// Version of an operator set.
    OperatorSet {
        1 domain: String, string;
        2 version: i64, int64;
    }

    /// A metadata entry: key and value.
    Property {
        1 key: String, string;
        2 value: String, string;
    }

    /// A graph: nodes in order of evaluation, constants, inputs and outputs.
    Graph {
        1 node: Vec<Node>, message, repeated;
        2 name: String, string;
        5 initializer: Vec<TensorProto>, message, repeated;
        11 input: Vec<ValueInfo>, message, repeated;
        12 output: Vec<ValueInfo>, message, repeated;
    }

    /// A node of the graph: one operator.
    Node {
        1 input: Vec<String>, string, repeated;
        2 output: Vec<String>, string, repeated;
        3 name: String, string;
        4 op_type: String, string;
        5 attribute: Vec<Attribute>, message, repeated;
        7 domain: String, string;
    }

    /// An attribute of an operator.
    Attribute {
        1 name: String, string;
        2 f: f32, float;
        3 i: i64, int64;
        4 s: Vec<u8>, bytes = "vec";
        5 t: Option<TensorProto>, message, optional;
        7 floats: Vec<f32>, float, repeated;
        8 ints: Vec<i64>, int64, repeated;
        20 kind: i32, int32;
    }

    /// A constant, row-major: little-endian in `raw_data`, or in the field of its type.
    TensorProto {
        1 dims: Vec<i64>, int64, repeated;
        2 data_type: i32, int32;
        4 float_data: Vec<f32>, float, repeated;
        5 int32_data: Vec<i32>, int32, repeated;
        7 int64_data: Vec<i64>, int64, repeated;
        8 name: String, string;
        9 raw_data: Vec<u8>, bytes = "vec";
        10 double_data: Vec<f64>, double, repeated;
        /// Position of values in another file: `location` (its name), `offset` and `length` \[bytes\].
        13 external_data: Vec<Property>, message, repeated;
        /// Location of the values: 1 if they are in another file.
        14 data_location: i32, int32;
    }

    /// Name and type of an input or output.
    ValueInfo {
        1 name: String, string;
        2 kind: Option<Type>, message, optional;
        3 doc_string: String, string;
    }

    /// Type of a value; only tensors are supported.
    Type {
        1 tensor_type: Option<TensorType>, message, optional;
    }

    /// Element type and shape of a tensor.
    TensorType {
        1 elem_type: i32, int32;
        2 shape: Option<TensorShapeProto>, message, optional;
    }

    /// Shape of a tensor.
    TensorShapeProto {
        1 dim: Vec<Dimension>, message, repeated;
    }
}

/// A dimension: its size, or the name of an open size.
#[derive(Clone, PartialEq, Message)]
pub struct Dimension {
    #[prost(oneof = "Size", tags = "1, 2")]
    pub size: Option<Size>,
}

/// The kinds of a [`Dimension`].
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Size {
    #[prost(int64, tag = "1")]
    Value(i64),
    #[prost(string, tag = "2")]
    Name(String),
}

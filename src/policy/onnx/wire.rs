//! Size check of a protobuf message before it is decoded.
//!
//! Two bytes on disk can become a message of 200 in memory. A file of a few megabytes could thus ask for gigabytes; a
//! policy has a few thousand fields at most.

use super::{Result, Unsupported};

/// Maximum number of fields of all messages together, far more than a policy has.
const MAX_FIELDS: usize = 100_000;

/// The kinds of the schema's messages that contain other messages.
#[derive(Clone, Copy)]
enum MessageKind {
    Model,
    Graph,
    Node,
    Attribute,
    Tensor,
    ValueInfo,
    Type,
    TensorType,
    Shape,
    /// A message without other messages: few fields, or packed ones whose size is that of the file.
    Leaf,
}

impl MessageKind {
    /// Returns the type of the message in a length-delimited field, if it is a message.
    fn child(self, field: u64) -> Option<MessageKind> {
        match (self, field) {
            (MessageKind::Model, 7) => Some(MessageKind::Graph),
            (MessageKind::Model, 8 | 14) | (MessageKind::Tensor, 13) => Some(MessageKind::Leaf),
            (MessageKind::Graph, 5) | (MessageKind::Attribute, 5) => Some(MessageKind::Tensor),
            (MessageKind::Graph, 1) => Some(MessageKind::Node),
            (MessageKind::Graph, 11 | 12) => Some(MessageKind::ValueInfo),
            (MessageKind::Node, 5) => Some(MessageKind::Attribute),
            (MessageKind::ValueInfo, 2) => Some(MessageKind::Type),
            (MessageKind::Type, 1) => Some(MessageKind::TensorType),
            (MessageKind::TensorType, 2) => Some(MessageKind::Shape),
            (MessageKind::Shape, 1) => Some(MessageKind::Leaf),
            _ => None,
        }
    }
}

/// Checks that bytes have no more fields than a policy can have, and are not truncated.
pub fn check(bytes: &[u8]) -> Result<()> {
    let mut fields = 0;
    count(bytes, MessageKind::Model, &mut fields)
}

/// Counts fields. The schema is a tree of a few levels, and so is this recursion.
fn count(mut bytes: &[u8], message: MessageKind, fields: &mut usize) -> Result<()> {
    let cut = || Unsupported::from("it is cut off or not ONNX");
    while !bytes.is_empty() {
        *fields += 1;
        ensure!(*fields <= MAX_FIELDS, "it has more than {MAX_FIELDS} fields, far more than a policy");
        let key = varint(&mut bytes).ok_or_else(cut)?;
        let length = match key & 7 {
            0 => {
                varint(&mut bytes).ok_or_else(cut)?;
                0
            }
            1 => 8,
            2 => usize::try_from(varint(&mut bytes).ok_or_else(cut)?).map_err(|_| cut())?,
            5 => 4,
            _ => return Err(cut()),
        };
        let (content, rest) = bytes.split_at_checked(length).ok_or_else(cut)?;
        if let (2, Some(child)) = (key & 7, message.child(key >> 3)) {
            count(content, child, fields)?;
        }
        bytes = rest;
    }
    Ok(())
}

/// Reads a base-128 number of at most 64 bits.
fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (first, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(first & 0x7f) << shift;
        if first & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_million_empty_nodes_are_refused_before_they_are_decoded() {
        // Field 7 (graph) with 2·10⁶ bytes: field 1 (node) of length 0, a million times.
        let mut bytes = vec![0x3a, 0x80, 0x89, 0x7a];
        bytes.extend([0x0a, 0x00].repeat(1_000_000));
        let error = check(&bytes).unwrap_err().to_string();
        assert!(error.contains("far more than a policy"), "{error}");
    }

    #[test]
    fn a_length_beyond_the_end_is_refused() {
        assert!(check(&[0x3a, 0xff, 0xff, 0xff, 0xff, 0x0f, 0x00]).is_err());
        assert!(check(&[0x3a]).is_err());
        assert!(check(&[0x08, 0x08]).is_ok());
    }
}

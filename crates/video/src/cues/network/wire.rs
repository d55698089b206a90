//! A look at an ONNX file before the runtime gets it: whether every field fits into what holds it, and which operators there are.
//!
//! The runtime makes room for as many bytes as a field claims to have. Field numbers are those of onnx.proto.

/// Messages that hold messages, and those.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Message {
    Model,
    Graph,
    Node,
    Attribute,
    Tensor,
    Value,
    Type,
    TensorType,
    Shape,
    /// Holds text and numbers alone.
    Plain,
}

/// Deepest nesting of messages: graphs in attributes of nodes of graphs.
const DEEPEST: usize = 64;
/// Field of a node that names its operator.
const OPERATOR: u64 = 4;

impl Message {
    /// What a field of bytes is; `None` for text, numbers and weights.
    fn within(self, field: u64) -> Option<Self> {
        match (self, field) {
            (Self::Model, 7) | (Self::Attribute, 6 | 11) => Some(Self::Graph),
            (Self::Graph, 1) => Some(Self::Node),
            (Self::Graph, 5) | (Self::Attribute, 5 | 10) => Some(Self::Tensor),
            (Self::Graph, 11..=13) => Some(Self::Value),
            (Self::Node, 5) => Some(Self::Attribute),
            (Self::Value, 2) => Some(Self::Type),
            (Self::Type, 1) => Some(Self::TensorType),
            (Self::TensorType, 2) => Some(Self::Shape),
            (Self::Model, 8 | 14) | (Self::Shape, 1) | (Self::Tensor, 13) => Some(Self::Plain),
            _ => None,
        }
    }
}

/// Operators of all nodes, in the order of the file; `None` where a field reaches beyond what holds it.
pub fn operators(file: &[u8]) -> Option<Vec<&[u8]>> {
    let mut found = Vec::new();
    walk(file, Message::Model, 0, &mut found)?;
    Some(found)
}

fn walk<'a>(mut bytes: &'a [u8], message: Message, depth: usize, operators: &mut Vec<&'a [u8]>) -> Option<()> {
    if depth > DEEPEST {
        return None;
    }
    while !bytes.is_empty() {
        let tag = varint(&mut bytes)?;
        let length = match tag & 7 {
            0 => {
                varint(&mut bytes)?;
                continue;
            }
            1 => 8,
            2 => usize::try_from(varint(&mut bytes)?).ok()?,
            5 => 4,
            _ => return None,
        };
        let (value, rest) = bytes.split_at_checked(length)?;
        bytes = rest;
        if tag & 7 == 2 {
            if let Some(inner) = message.within(tag >> 3) {
                walk(value, inner, depth + 1, operators)?;
            } else if message == Message::Node && tag >> 3 == OPERATOR {
                operators.push(value);
            }
        }
    }
    Some(())
}

/// A number in base 128, the least digit first.
fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut number = 0u64;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = bytes.split_first()?;
        *bytes = rest;
        number |= u64::from(byte & 127) << shift;
        if byte & 128 == 0 {
            return Some(number);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operators_are_found_and_fields_that_reach_too_far_are_not_followed() {
        // Model {7: Graph {1: Node {4: "Relu"}}}, and a field of four bytes beside the graph.
        let node = [&[0x22, 4], b"Relu".as_slice()].concat();
        let graph = [&[0x0a, node.len() as u8][..], &node].concat();
        let file = [&[0x08, 0x88, 0x01, 0x3a, graph.len() as u8][..], &graph, &[0x2d, 1, 2, 3, 4]].concat();
        assert_eq!(operators(&file), Some(vec![b"Relu".as_slice()]));
        assert_eq!(operators(&file[..file.len() - 1]), None);
        let mut long = file.clone();
        long[8] = 100;
        assert_eq!(operators(&long), None);
        assert_eq!(operators(&[0x3a; 40]), None);
        let mut deep = Vec::new();
        for _ in 0..60 {
            deep = [&[0x32, deep.len() as u8][..], &deep].concat();
            deep = [&[0x2a, deep.len() as u8][..], &deep].concat();
            deep = [&[0x0a, deep.len() as u8][..], &deep].concat();
            deep.truncate(120);
        }
        assert_eq!(operators(&deep), None);
    }
}

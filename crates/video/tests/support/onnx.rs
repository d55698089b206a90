//! Small networks as the bytes of ONNX files, written field by field.

/// A number in base 128.
fn varint(mut n: u64, out: &mut Vec<u8>) {
    while n > 127 {
        out.push(n as u8 | 128);
        n >>= 7;
    }
    out.push(n as u8);
}

/// A field that is a number.
fn number(field: u64, value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    varint(field << 3, &mut out);
    varint(value, &mut out);
    out
}

/// A field of bytes: text or a message.
fn bytes(field: u64, value: impl AsRef<[u8]>) -> Vec<u8> {
    let mut out = Vec::new();
    varint(field << 3 | 2, &mut out);
    varint(value.as_ref().len() as u64, &mut out);
    out.extend_from_slice(value.as_ref());
    out
}

/// TensorProto of floats.
fn tensor(name: &str, shape: &[u64], values: &[f32]) -> Vec<u8> {
    let mut out: Vec<u8> = shape.iter().flat_map(|&d| number(1, d)).collect();
    out.extend(number(2, 1));
    out.extend(bytes(8, name));
    out.extend(bytes(9, values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()));
    out
}

/// ValueInfoProto of floats; 0 is a side that the file leaves open.
fn value(name: &str, shape: &[u64]) -> Vec<u8> {
    let side = |(k, &n): (usize, &u64)| bytes(1, if n > 0 { number(1, n) } else { bytes(2, format!("side_{k}")) });
    let sides: Vec<u8> = shape.iter().enumerate().flat_map(side).collect();
    let floats = [number(1, 1), bytes(2, sides)].concat();
    [bytes(1, name), bytes(2, bytes(1, floats))].concat()
}

/// AttributeProto of whole numbers.
fn whole(name: &str, values: &[u64]) -> Vec<u8> {
    let list: Vec<u8> = values.iter().flat_map(|&v| number(8, v)).collect();
    [bytes(1, name), list, number(20, 7)].concat()
}

/// NodeProto.
fn node(operator: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
    let inputs: Vec<u8> = inputs.iter().flat_map(|i| bytes(1, i)).collect();
    let attributes: Vec<u8> = attributes.iter().flat_map(|a| bytes(5, a)).collect();
    [inputs, bytes(2, output), bytes(4, operator), attributes].concat()
}

/// A network of one convolution, 3x3 with a weight for each of `channels` that is the same in all nine places, and what comes after it.
pub struct Network<'a> {
    /// Shape of the input; 0 is open.
    pub input: [u64; 4],
    /// Weight of each channel of the mean over 3x3.
    pub channels: &'a [f32],
    /// What is added.
    pub bias: f32,
    /// The operator after the convolution.
    pub after: &'a str,
}

impl Network<'_> {
    /// The file.
    pub fn onnx(&self) -> Vec<u8> {
        let weights: Vec<f32> = self.channels.iter().flat_map(|w| [w / 9.0; 9]).collect();
        let nodes = [
            node(
                "Conv",
                &["picture", "weights", "bias"],
                "sum",
                &[whole("pads", &[1; 4]), whole("kernel_shape", &[3; 2])],
            ),
            node(self.after, &["sum"], "out", &[]),
        ];
        let graph = [
            nodes.iter().flat_map(|n| bytes(1, n)).collect(),
            bytes(2, "tiny"),
            bytes(5, tensor("weights", &[1, self.channels.len() as u64, 3, 3], &weights)),
            bytes(5, tensor("bias", &[1], &[self.bias])),
            bytes(11, value("picture", &self.input)),
            bytes(12, value("out", &[1, 1, self.input[2], self.input[3]])),
        ];
        [number(1, 8), bytes(7, graph.concat()), bytes(8, [bytes(1, ""), number(2, 13)].concat())].concat()
    }
}

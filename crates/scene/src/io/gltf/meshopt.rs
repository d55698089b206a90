//! EXT_meshopt_compression: decoding of compressed buffer views.
//!
//! Follows the bitstream of the extension's specification (Khronos registry, EXT_meshopt_compression, appendices A and B): attributes
//! (version 0), triangles (version 0 and 1), index sequences (version 1), and the filters OCTAHEDRAL, QUATERNION, EXPONENTIAL. Written here because the
//! element size is known only at run time, and every read is checked.

use super::json::Place;
use crate::io::SceneError;

/// Decoded bytes of one view.
const MAX_BYTES: usize = 1 << 30;
/// A vertex block holds at most this many bytes, and this many elements.
const BLOCK_BYTES: usize = 8192;
const BLOCK_ELEMENTS: usize = 256;
/// Elements that share one delta coding.
const GROUP: usize = 16;

/// Decodes the view described by `extension` from its compressed bytes.
pub(super) fn decode(extension: &Place, data: &[u8]) -> Result<Vec<u8>, SceneError> {
    let stride = extension.need("byteStride")?.usize()?;
    let count = extension.need("count")?.usize()?;
    let mode = extension.text("mode");
    let broken = || extension.invalid(format!("its {mode} data are broken or cut off"));
    let sound = match mode {
        "ATTRIBUTES" => stride > 0 && stride <= 256 && stride.is_multiple_of(4),
        "TRIANGLES" => (stride == 2 || stride == 4) && count.is_multiple_of(3),
        "INDICES" => stride == 2 || stride == 4,
        other => return Err(extension.unsupported(format!("compression mode {other:?} is not read"))),
    };
    if !sound {
        return Err(extension.invalid(format!("{mode} with a stride of {stride} and {count} elements")));
    }
    // Bits do not come for nothing: a group of 16 bytes takes at least 2 bits, a triangle a byte, an index a byte.
    let least = if mode == "ATTRIBUTES" { stride * count / 64 } else { count / 3 };
    if count.checked_mul(stride).is_none_or(|n| n > MAX_BYTES) || least > data.len() {
        return Err(extension.limit(format!("{count} elements cannot come from {} bytes", data.len())));
    }
    let mut out = match mode {
        "ATTRIBUTES" => attributes(data, count, stride).ok_or_else(broken)?,
        "TRIANGLES" => pack(&triangles(data, count).ok_or_else(broken)?, stride),
        _ => pack(&sequence(data, count).ok_or_else(broken)?, stride),
    };
    match extension.text("filter") {
        "" | "NONE" => {}
        "OCTAHEDRAL" if stride == 4 || stride == 8 => octahedral(&mut out, stride),
        "QUATERNION" if stride == 8 => quaternion(&mut out),
        "EXPONENTIAL" => exponential(&mut out),
        other => return Err(extension.unsupported(format!("filter {other:?} with a stride of {stride} is not read"))),
    }
    Ok(out)
}

fn pack(indices: &[u32], stride: usize) -> Vec<u8> {
    if stride == 2 {
        indices.iter().flat_map(|&i| (i as u16).to_le_bytes()).collect()
    } else {
        indices.iter().flat_map(|i| i.to_le_bytes()).collect()
    }
}

fn unzigzag8(v: u8) -> u8 {
    (v & 1).wrapping_neg() ^ (v >> 1)
}

/// Mode 0. The tail holds the first element (padded to 32 bytes at least).
fn attributes(data: &[u8], count: usize, stride: usize) -> Option<Vec<u8>> {
    if *data.first()? != 0xa0 {
        return None;
    }
    let tail = stride.max(32);
    let body_end = data.len().checked_sub(tail).filter(|&n| n >= 1)?;
    let mut last: Vec<u8> = data[data.len() - stride..].to_vec();
    let block = (BLOCK_BYTES / stride).min(BLOCK_ELEMENTS) & !(GROUP - 1);
    let (mut out, mut at) = (vec![0u8; count * stride], 1);
    for first in (0..count).step_by(block) {
        let n = block.min(count - first);
        for byte in 0..stride {
            let deltas = byte_stream(&data[..body_end], &mut at, n)?;
            for (i, &d) in deltas.iter().take(n).enumerate() {
                last[byte] = last[byte].wrapping_add(unzigzag8(d));
                out[(first + i) * stride + byte] = last[byte];
            }
        }
    }
    Some(out)
}

/// One byte of every element of a block: 2 header bits for each group of 16, then the groups.
fn byte_stream(data: &[u8], at: &mut usize, n: usize) -> Option<Vec<u8>> {
    let groups = n.div_ceil(GROUP);
    let header = data.get(*at..*at + groups.div_ceil(4))?;
    *at += header.len();
    let mut out = Vec::with_capacity(groups * GROUP);
    for g in 0..groups {
        let bits = match header[g / 4] >> (g % 4 * 2) & 3 {
            0 => {
                out.extend([0; GROUP]);
                continue;
            }
            1 => 2,
            2 => 4,
            _ => {
                out.extend(data.get(*at..*at + GROUP)?);
                *at += GROUP;
                continue;
            }
        };
        let packed = data.get(*at..*at + GROUP * bits / 8)?;
        *at += packed.len();
        let sentinel = (1u8 << bits) - 1;
        for i in 0..GROUP {
            let per_byte = 8 / bits;
            let value = packed[i / per_byte] >> ((per_byte - 1 - i % per_byte) * bits) & sentinel;
            if value == sentinel {
                out.push(*data.get(*at)?);
                *at += 1;
            } else {
                out.push(value);
            }
        }
    }
    Some(out)
}

/// A little-endian base-128 number of at most five bytes.
fn varint(data: &[u8], at: &mut usize) -> Option<u32> {
    let mut value = 0u32;
    for shift in (0..35).step_by(7) {
        let byte = *data.get(*at)?;
        *at += 1;
        value |= u32::from(byte & 127).checked_shl(shift).unwrap_or(0);
        if byte < 128 {
            break;
        }
    }
    Some(value)
}

fn delta(data: &[u8], at: &mut usize, last: &mut u32) -> Option<u32> {
    let v = varint(data, at)?;
    *last = last.wrapping_add((v >> 1) ^ (v & 1).wrapping_neg());
    Some(*last)
}

/// Ring buffers of recent edges and vertices.
struct Recent {
    edges: [[u32; 2]; 16],
    edge: usize,
    vertices: [u32; 16],
    vertex: usize,
}

impl Recent {
    fn push_edge(&mut self, a: u32, b: u32) {
        self.edges[self.edge] = [a, b];
        self.edge = (self.edge + 1) & 15;
    }

    fn push_vertex(&mut self, v: u32) {
        self.vertices[self.vertex] = v;
        self.vertex = (self.vertex + 1) & 15;
    }

    fn edge_back(&self, n: usize) -> [u32; 2] {
        self.edges[self.edge.wrapping_sub(1 + n) & 15]
    }

    fn vertex_back(&self, n: usize) -> u32 {
        self.vertices[self.vertex.wrapping_sub(n) & 15]
    }
}

/// Mode 1: a code byte a triangle, extra data behind, 16 auxiliary codes at the end.
fn triangles(data: &[u8], count: usize) -> Option<Vec<u32>> {
    let version = match *data.first()? {
        0xe0 => 0,
        0xe1 => 1,
        _ => return None,
    };
    let codes = data.get(1..1 + count / 3)?;
    let end = data.len().checked_sub(16)?;
    let auxiliary = &data[end..];
    let mut at = 1 + codes.len();
    if at > end {
        return None;
    }
    let body = &data[..end];
    let mut recent = Recent { edges: [[u32::MAX; 2]; 16], edge: 0, vertices: [u32::MAX; 16], vertex: 0 };
    let (mut next, mut last) = (0u32, 0u32);
    // Codes of the free vertex up to this one look into the vertex ring; in version 1, two more mean last ± 1.
    let ring_codes = if version >= 1 { 13 } else { 15 };
    let mut out = Vec::with_capacity(count);
    for &code in codes {
        let (high, low) = (usize::from(code >> 4), usize::from(code & 15));
        if high < 15 {
            let [a, b] = recent.edge_back(high);
            let c = if low == 0 {
                next = next.wrapping_add(1);
                recent.push_vertex(next.wrapping_sub(1));
                next.wrapping_sub(1)
            } else if low < ring_codes {
                recent.vertex_back(1 + low)
            } else {
                let c = match low {
                    13 => last.wrapping_sub(1),
                    14 => last.wrapping_add(1),
                    _ => delta(body, &mut at, &mut last)?,
                };
                last = c;
                recent.push_vertex(c);
                c
            };
            recent.push_edge(c, b);
            recent.push_edge(a, c);
            out.extend([a, b, c]);
            continue;
        }
        let (implicit, pair) = if low < 14 {
            (true, auxiliary[low])
        } else {
            let byte = *body.get(at)?;
            at += 1;
            (low == 14, byte)
        };
        if low >= 14 && pair == 0 {
            next = 0;
        }
        let (fb, fc) = (usize::from(pair >> 4), usize::from(pair & 15));
        let fresh = |next: &mut u32| {
            *next = next.wrapping_add(1);
            next.wrapping_sub(1)
        };
        let mut a = if implicit { fresh(&mut next) } else { 0 };
        let mut b = if fb == 0 { fresh(&mut next) } else { recent.vertex_back(fb) };
        let mut c = if fc == 0 { fresh(&mut next) } else { recent.vertex_back(fc) };
        if !implicit {
            a = delta(body, &mut at, &mut last)?;
        }
        if low >= 14 && fb == 15 {
            b = delta(body, &mut at, &mut last)?;
        }
        if low >= 14 && fc == 15 {
            c = delta(body, &mut at, &mut last)?;
        }
        recent.push_vertex(a);
        if fb == 0 || (low >= 14 && fb == 15) {
            recent.push_vertex(b);
        }
        if fc == 0 || (low >= 14 && fc == 15) {
            recent.push_vertex(c);
        }
        recent.push_edge(b, a);
        recent.push_edge(c, b);
        recent.push_edge(a, c);
        out.extend([a, b, c]);
    }
    Some(out)
}

/// Mode 2: deltas to one of two baselines.
fn sequence(data: &[u8], count: usize) -> Option<Vec<u32>> {
    if *data.first()? != 0xd1 {
        return None;
    }
    let body = &data[..data.len().checked_sub(4)?];
    let (mut at, mut last) = (1, [0u32; 2]);
    (0..count)
        .map(|_| {
            let v = varint(body, &mut at)?;
            let (baseline, v) = ((v & 1) as usize, v >> 1);
            last[baseline] = last[baseline].wrapping_add((v >> 1) ^ (v & 1).wrapping_neg());
            Some(last[baseline])
        })
        .collect()
}

fn round(x: f32) -> i32 {
    (x + if x >= 0.0 { 0.5 } else { -0.5 }) as i32
}

/// Filter 1: octahedral normals; x, y encoded, z holds the value of one, w is kept.
fn octahedral(out: &mut [u8], stride: usize) {
    let size = stride / 4;
    for element in out.chunks_exact_mut(stride) {
        let get = |i: usize| -> i32 {
            if size == 1 {
                i32::from(element[i] as i8)
            } else {
                i32::from(i16::from_le_bytes([element[2 * i], element[2 * i + 1]]))
            }
        };
        let (mut x, mut y, one) = (get(0) as f32, get(1) as f32, get(2) as f32);
        let z = one - x.abs() - y.abs();
        let t = z.min(0.0);
        x += if x >= 0.0 { t } else { -t };
        y += if y >= 0.0 { t } else { -t };
        let full = if size == 1 { 127.0 } else { 32767.0 };
        let scale = full / (x * x + y * y + z * z).sqrt();
        for (i, v) in [x, y, z].into_iter().enumerate() {
            let v = round(v * scale);
            if size == 1 {
                element[i] = v as i8 as u8;
            } else {
                element[2 * i..2 * i + 2].copy_from_slice(&(v as i16).to_le_bytes());
            }
        }
    }
}

/// Filter 2: three components, the largest follows from the unit length and its place stands in the two low bits of the fourth.
fn quaternion(out: &mut [u8]) {
    for element in out.chunks_exact_mut(8) {
        let get = |i: usize| i16::from_le_bytes([element[2 * i], element[2 * i + 1]]);
        let w_code = i32::from(get(3));
        let scale = std::f32::consts::FRAC_1_SQRT_2 / (w_code | 3) as f32;
        let [x, y, z] = [0, 1, 2].map(|i| f32::from(get(i)) * scale);
        let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
        let largest = (w_code & 3) as usize;
        for (k, v) in [x, y, z, w].into_iter().enumerate() {
            let place = (largest + 1 + k) % 4;
            element[2 * place..2 * place + 2].copy_from_slice(&(round(v * 32767.0) as i16).to_le_bytes());
        }
    }
}

/// Filter 3: 24-bit mantissa and 8-bit exponent, both signed.
fn exponential(out: &mut [u8]) {
    for word in out.as_chunks_mut::<4>().0 {
        let v = i32::from_le_bytes(*word);
        let (exponent, mantissa) = (v >> 24, v << 8 >> 8);
        *word = (mantissa as f32 * 2f32.powi(exponent)).to_le_bytes();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(hex: &str) -> Vec<u8> {
        (0..hex.len()).step_by(2).map(|i| u8::from_str_radix(&hex[i..i + 2], 16).unwrap()).collect()
    }

    // Encoded by the meshoptimizer project's own encoder from the sequences that the tests compute.
    const ATTRIBUTES: &str = "a00000152aaaaaaaaaaaaaaaaaaa00002a0444444444444444444444444444444444444444000000002a0666666666666666\
        666666666666666666666666000000001f000c243c546c849cb4cce4fcebd3bba38b735b432b13041c344c647c94acc4dcff\
        ff0000f4f3dbc3ab937b631f000e2a46627e9ab6d2eef5d9bda185694d311506223e5a7692aecae6fde1c5a9ffdf00008d71\
        55391d1a361f001030507090b0d0f0efcfaf8f6f4f2f0f1030507090b0d0f0efcfaf8f6f4f2fffff00000f1030507090b0d0\
        00000000000000000000000000000000000000000000000000000000000f1215";
    const TRIANGLES: &str = "e1fe1e100e100e100ece1e160e150e140ece1e140e140e140ece1e140e140e140effff0f0a8f290cffc604d304dcc5080076\
        87566778a9866589689801690000";
    const SEQUENCE: &str = "d100dd9a0c70e101d002c103b004a10590068107f007e108ce15df14b00ba10c900d9f11ae10e10fd010df0dee0ca1138e0b\
        9f0af015bf08ce07c11800000000";

    #[test]
    fn attributes_with_all_group_widths_decode_to_what_was_encoded() {
        let value = |i: usize, b: usize| match b {
            0 | 1 => 0,
            2..5 => (i * (b - 1)) & 255,
            _ => (i * i * (b + 1) + 3 * b) & 255,
        };
        let expected: Vec<u8> = (0..40 * 8).map(|k| value(k / 8, k % 8) as u8).collect();
        assert_eq!(attributes(&bytes(ATTRIBUTES), 40, 8).unwrap(), expected);
    }

    #[test]
    fn triangles_decode_to_what_was_encoded_up_to_rotation() {
        let mut expected: Vec<[u32; 3]> = Vec::new();
        for a in (0..20).filter(|a| a % 5 < 4) {
            expected.extend([[a, a + 1, a + 5], [a + 1, a + 6, a + 5]]);
        }
        expected.extend([[3, 17, 9], [300, 2, 70_000]]);
        let decoded = triangles(&bytes(TRIANGLES), 102).unwrap();
        for (k, (d, e)) in decoded.as_chunks::<3>().0.iter().zip(&expected).enumerate() {
            let turned = (0..3).any(|r| [e[r], e[(r + 1) % 3], e[(r + 2) % 3]] == *d);
            assert!(turned, "triangle {k}: {d:?}, encoded {e:?}");
        }
    }

    #[test]
    fn index_sequences_decode_to_what_was_encoded() {
        let expected: Vec<u32> = (0..30).map(|i| i * i * 7 % 1000 + i % 2 * 50_000).collect();
        assert_eq!(sequence(&bytes(SEQUENCE), 30).unwrap(), expected);
    }

    #[test]
    fn every_cut_of_the_streams_is_refused_without_a_panic() {
        let (a, t, s) = (bytes(ATTRIBUTES), bytes(TRIANGLES), bytes(SEQUENCE));
        for n in 0..a.len() {
            assert!(attributes(&a[..n], 40, 8).is_none(), "attributes cut at {n}");
        }
        (0..t.len()).for_each(|n| drop(triangles(&t[..n], 102)));
        (0..s.len()).for_each(|n| drop(sequence(&s[..n], 30)));
        assert!(triangles(&t[..50], 102).is_none() && sequence(&s[..20], 30).is_none());
    }

    #[test]
    fn filters_give_unit_normals_unit_quaternions_and_scaled_floats() {
        let mut normal = [40u8, 30, 127, 5];
        octahedral(&mut normal, 4);
        let n = [normal[0], normal[1], normal[2]].map(|b| f64::from(b as i8) / 127.0);
        let length = n.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((length - 1.0).abs() < 0.01 && normal[3] == 5, "{normal:?}");
        assert!((n[0] / n[1] - 4.0 / 3.0).abs() < 0.05, "{n:?}");
        let mut q: Vec<u8> = [1000i16, -500, 250, 0x7ffc | 2].iter().flat_map(|x| x.to_le_bytes()).collect();
        quaternion(&mut q);
        let q: Vec<f64> = q.as_chunks::<2>().0.iter().map(|b| f64::from(i16::from_le_bytes(*b)) / 32767.0).collect();
        assert!((q.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-3 && q[2] > 0.99, "{q:?}");
        let mut e = (-3i32 << 24 | 40).to_le_bytes();
        exponential(&mut e);
        assert_eq!(f32::from_le_bytes(e), 5.0);
    }
}

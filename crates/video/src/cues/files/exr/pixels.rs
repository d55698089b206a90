//! Blocks of lines of an OpenEXR file, and the numbers in them.

use super::header::{Bytes, Parsed, Part, size};
use animimic_scene::DepthMap;

/// Distances from here on mean that no surface was met, as Blender writes them.
const NO_SURFACE: f32 = 1e9;

/// Puts the lines of a chunk where they belong.
pub fn place(part: &Part, channel: usize, chunk: &mut Bytes, map: &mut DepthMap) -> Parsed<()> {
    let broken = || "a block of the EXR file is broken; write it again".to_owned();
    let ([left, top, _, bottom], lines) = (part.data, part.lines_per_chunk()?);
    let first = chunk.i32()?;
    let length = usize::try_from(chunk.i32()?).map_err(|_| broken())?;
    let stored = chunk.take(length)?;
    if !(top..=bottom).contains(&first) || !((first - top) as usize).is_multiple_of(lines) {
        return Err(broken());
    }
    let count = lines.min((i64::from(bottom) - i64::from(first) + 1) as usize);
    let width = size(part.data)[0] as usize;
    let stride: usize = part.channels.iter().map(|c| width * c.size()).sum();
    let pixels = match (part.compression, length == count * stride) {
        (0, _) | (_, true) => stored.to_vec(),
        (1, _) => filtered(&unrun(stored, count * stride)),
        _ => filtered(
            &miniz_oxide::inflate::decompress_to_vec_zlib_with_limit(stored, count * stride).map_err(|_| broken())?,
        ),
    };
    if pixels.len() != count * stride {
        return Err(broken());
    }
    let start: usize = part.channels[..channel].iter().map(|c| width * c.size()).sum();
    let (kind, each) = (part.channels[channel].kind, part.channels[channel].size());
    for k in 0..count {
        let y = i64::from(first) + k as i64 - i64::from(part.display[1]);
        let line = &pixels[k * stride + start..][..width * each];
        for (i, sample) in line.chunks(each).enumerate() {
            let x = i64::from(left) + i as i64 - i64::from(part.display[0]);
            let inside = (0..map.width as i64).contains(&x) && (0..map.height as i64).contains(&y);
            let value = number(kind, sample);
            if inside && value > 0.0 && value < NO_SURFACE {
                map.values[y as usize * map.width + x as usize] = value;
            }
        }
    }
    Ok(())
}

/// A sample of two or four bytes.
fn number(kind: i32, bytes: &[u8]) -> f32 {
    match (kind, bytes) {
        (0, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]) as f32,
        (2, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
        (_, &[a, b, ..]) => from_half(u16::from_le_bytes([a, b])),
        _ => f32::NAN,
    }
}

/// IEEE 754 binary16.
fn from_half(bits: u16) -> f32 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f32::from(bits & 0x3ff) / 1024.0);
    let size = match exponent {
        0 => fraction * 2f32.powi(-14),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        e => (1.0 + fraction) * 2f32.powi(e - 15),
    };
    if bits >> 15 == 1 { -size } else { size }
}

/// Run lengths: a count n ≥ 0 repeats the next byte n + 1 times, one below 0 is followed by −n bytes as they are.
fn unrun(mut bytes: &[u8], most: usize) -> Vec<u8> {
    let mut out = Vec::new();
    while let [count, rest @ ..] = bytes {
        let count = *count as i8;
        let taken = if count < 0 { usize::from(count.unsigned_abs()) } else { 1 }.min(rest.len());
        if count < 0 {
            out.extend_from_slice(&rest[..taken]);
        } else {
            out.extend(rest[..taken].iter().flat_map(|b| std::iter::repeat_n(*b, count as usize + 1)));
        }
        bytes = &rest[taken..];
        if out.len() > most {
            break;
        }
    }
    out
}

/// Undoes what was done before compression: differences of neighbours, and all even bytes in front of all odd ones.
fn filtered(bytes: &[u8]) -> Vec<u8> {
    let mut sums = bytes.to_vec();
    for i in 1..sums.len() {
        sums[i] = sums[i - 1].wrapping_add(sums[i]).wrapping_sub(128);
    }
    let half = sums.len().div_ceil(2);
    (0..sums.len()).map(|i| sums[i / 2 + if i % 2 == 1 { half } else { 0 }]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_what_the_standard_says() {
        for (bits, value) in
            [(0x3c00, 1.0), (0xc000, -2.0), (0x7bff, 65504.0), (0x0001, 2f32.powi(-24)), (0x3555, 0.333_251_95)]
        {
            assert_eq!(from_half(bits), value);
        }
        assert!(from_half(0x7c00) == f32::INFINITY && from_half(0x7e00).is_nan());
    }
}

//! H.264 parameter sets: what the embedded decoder does not tell (ITU-T H.264 §7.3.2.1.1, Annex E), and NAL framing.

use crate::color::ColorSpace;

/// What a sequence parameter set says about the pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SequenceInfo {
    /// 1 = 4:2:0.
    pub chroma_format_idc: u32,
    /// Bits per luma sample.
    pub bit_depth: u32,
    /// Coded size in luma samples, before cropping.
    pub coded_size: (u64, u64),
    /// H.273 matrix coefficients; 2 when unspecified.
    pub matrix_coefficients: u8,
    /// 0–255 rather than 16–235.
    pub full_range: bool,
}

impl SequenceInfo {
    /// The colour space, BT.601 limited when unspecified.
    pub fn color_space(&self) -> Option<ColorSpace> {
        ColorSpace::from_matrix_coefficients(self.matrix_coefficients, self.full_range)
    }
}

/// Bits of an RBSP, most significant first.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn bit(&mut self) -> Option<u32> {
        let byte = *self.bytes.get(self.at / 8)?;
        let bit = (byte >> (7 - self.at % 8)) & 1;
        self.at += 1;
        Some(u32::from(bit))
    }

    fn bits(&mut self, n: u32) -> Option<u32> {
        (0..n).try_fold(0u32, |v, _| Some((v << 1) | self.bit()?))
    }

    fn ue(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.bit()? == 0 {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        Some((1u32 << zeros) - 1 + self.bits(zeros)?)
    }

    fn se(&mut self) -> Option<i64> {
        let k = i64::from(self.ue()?);
        Some(if k % 2 == 0 { -(k / 2) } else { (k + 1) / 2 })
    }
}

/// NAL payload without emulation prevention bytes (00 00 03 → 00 00).
pub fn rbsp(nal: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(nal.len());
    let mut zeros = 0;
    for &b in nal {
        if zeros >= 2 && b == 3 {
            zeros = 0;
            continue;
        }
        zeros = if b == 0 { zeros + 1 } else { 0 };
        out.push(b);
    }
    out
}

fn skip_scaling_list(r: &mut Bits, size: usize) -> Option<()> {
    let (mut last, mut next) = (8i64, 8i64);
    for _ in 0..size {
        if next != 0 {
            next = (last + r.se()? + 256).rem_euclid(256);
        }
        last = if next == 0 { last } else { next };
    }
    Some(())
}

/// Parses a sequence parameter set NAL unit (with its header byte). `None` when it ends early or is out of range.
pub fn parse_sps(nal: &[u8]) -> Option<SequenceInfo> {
    let bytes = rbsp(nal.get(1..)?);
    let mut r = Bits { bytes: &bytes, at: 0 };
    let profile_idc = r.bits(8)?;
    r.bits(16)?;
    r.ue()?;
    let (mut chroma_format_idc, mut bit_depth) = (1, 8);
    if matches!(profile_idc, 100 | 110 | 122 | 244 | 44 | 83 | 86 | 118 | 128 | 138 | 139 | 134 | 135) {
        chroma_format_idc = r.ue()?;
        if chroma_format_idc == 3 {
            r.bit()?;
        }
        bit_depth = 8 + r.ue()?.max(r.ue()?);
        r.bit()?;
        if r.bit()? == 1 {
            for i in 0..if chroma_format_idc == 3 { 12 } else { 8 } {
                if r.bit()? == 1 {
                    skip_scaling_list(&mut r, if i < 6 { 16 } else { 64 })?;
                }
            }
        }
    }
    r.ue()?;
    match r.ue()? {
        0 => {
            r.ue()?;
        }
        1 => {
            r.bit()?;
            r.se()?;
            r.se()?;
            for _ in 0..r.ue()?.min(255) {
                r.se()?;
            }
        }
        _ => {}
    }
    r.ue()?;
    r.bit()?;
    let width = 16 * (u64::from(r.ue()?) + 1);
    let mut height = 16 * (u64::from(r.ue()?) + 1);
    if r.bit()? == 0 {
        height *= 2;
        r.bit()?;
    }
    r.bit()?;
    if r.bit()? == 1 {
        for _ in 0..4 {
            r.ue()?;
        }
    }
    let (matrix_coefficients, full_range) = if r.bit()? == 1 { parse_vui_color(&mut r)? } else { (2, false) };
    Some(SequenceInfo { chroma_format_idc, bit_depth, coded_size: (width, height), matrix_coefficients, full_range })
}

/// The colour description at the start of the VUI (Annex E.1.1).
fn parse_vui_color(r: &mut Bits) -> Option<(u8, bool)> {
    if r.bit()? == 1 && r.bits(8)? == 255 {
        r.bits(32)?;
    }
    if r.bit()? == 1 {
        r.bit()?;
    }
    if r.bit()? == 0 {
        return Some((2, false));
    }
    r.bits(3)?;
    let full_range = r.bit()? == 1;
    let matrix = if r.bit()? == 1 { (r.bits(24)? & 255) as u8 } else { 2 };
    Some((matrix, full_range))
}

/// Appends a VUI that states BT.709 limited range and no reordering to an SPS that has none.
///
/// `sps_rbsp`: without header byte and emulation prevention, ending in `vui_parameters_present_flag = 0` and the stop bit.
pub fn with_bt709_vui(sps_rbsp: &[u8]) -> Vec<u8> {
    let mut bits: Vec<u8> = sps_rbsp.iter().flat_map(|b| (0..8).rev().map(move |i| (b >> i) & 1)).collect();
    while bits.pop() == Some(0) {}
    bits.pop(); // vui_parameters_present_flag
    let mut put = |value: u32, n: u32| bits.extend((0..n).rev().map(|i| ((value >> i) & 1) as u8));
    put(1, 1); // vui_parameters_present_flag
    put(0, 2); // no aspect ratio, no overscan
    put(1, 1); // video_signal_type_present_flag
    put(5, 3); // video_format: unspecified
    put(0, 1); // limited range
    put(1, 1); // colour description: primaries, transfer, matrix
    put(0x01_01_01, 24);
    put(0, 5); // no chroma location, timing, NAL HRD, VCL HRD, pic_struct
    put(1, 1); // bitstream_restriction_flag
    put(1, 1); // motion vectors over picture boundaries
    put(0b1, 1); // max_bytes_per_pic_denom: ue(0), no limit
    put(0b1, 1); // max_bits_per_mb_denom: ue(0), no limit
    put(0b0000_10000, 9); // log2_max_mv_length_horizontal: ue(15), the value inferred without this
    put(0b0000_10000, 9); // log2_max_mv_length_vertical
    put(0b1, 1); // max_num_reorder_frames: ue(0)
    put(0b010, 3); // max_dec_frame_buffering: ue(1), our one reference frame
    put(1, 1); // rbsp stop bit
    bits.chunks(8).map(|c| c.iter().enumerate().fold(0u8, |v, (i, b)| v | (b << (7 - i)))).collect()
}

/// The NAL units of an Annex B stream, without start codes.
pub fn annex_b_nals(stream: &[u8]) -> Vec<&[u8]> {
    let mut starts = Vec::new();
    let mut i = 0;
    while i + 3 <= stream.len() {
        if stream[i..i + 3] == [0, 0, 1] {
            starts.push(i + 3);
            i += 3;
        } else {
            i += 1;
        }
    }
    let mut nals = Vec::with_capacity(starts.len());
    for (k, &start) in starts.iter().enumerate() {
        let mut end = starts.get(k + 1).map_or(stream.len(), |next| next - 3);
        while end > start && stream[end - 1] == 0 {
            end -= 1;
        }
        nals.push(&stream[start..end]);
    }
    nals
}

/// Length-prefixed sample (ISO/IEC 14496-15) → Annex B. `None` where a length points past the end.
pub fn annex_b_from_sample(sample: &[u8], length_size: usize) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(sample.len() + 16);
    let mut rest = sample;
    while rest.len() >= length_size {
        let length = rest[..length_size].iter().fold(0usize, |v, &b| (v << 8) | usize::from(b));
        rest = &rest[length_size..];
        if length > rest.len() {
            return None;
        }
        out.extend_from_slice(&[0, 0, 0, 1]);
        out.extend_from_slice(&rest[..length]);
        rest = &rest[length..];
    }
    Some(out)
}

/// What the slices of an Annex B access unit are: (contains an IDR slice, is used for reference).
pub fn access_unit_kind(annex_b: &[u8]) -> (bool, bool) {
    let (mut idr, mut reference) = (false, false);
    for nal in annex_b_nals(annex_b) {
        let Some(&header) = nal.first() else { continue };
        if matches!(header & 31, 1..=5) {
            idr |= header & 31 == 5;
            reference |= header & 0x60 != 0;
        }
    }
    (idr, reference)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_written_vui_is_read_back_as_bt709_limited() {
        let mut encoder = rusty_h264::Encoder::new(rusty_h264::EncoderConfig::baseline(100, 60)).expect("config");
        let stream = encoder.encode(&rusty_h264::YuvFrame::black(100, 60));
        let nals = annex_b_nals(&stream);
        let sps = nals.iter().find(|n| n[0] & 31 == 7).expect("SPS");
        let plain = parse_sps(sps).expect("parses");
        assert_eq!((plain.matrix_coefficients, plain.coded_size), (2, (112, 64)));
        let mut patched = vec![sps[0]];
        patched.extend(with_bt709_vui(&rbsp(&sps[1..])));
        let info = parse_sps(&patched).expect("parses");
        assert_eq!((info.matrix_coefficients, info.full_range, info.bit_depth), (1, false, 8));
        assert_eq!(info.color_space(), Some(ColorSpace::BT709));
    }

    #[test]
    fn a_length_past_the_end_of_a_sample_is_noticed() {
        assert!(annex_b_from_sample(&[0, 0, 0, 9, 1, 2], 4).is_none());
        assert_eq!(annex_b_from_sample(&[0, 2, 7, 8], 2), Some(vec![0, 0, 0, 1, 7, 8]));
    }
}

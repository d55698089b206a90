//! Depth in OpenEXR files (openexr.com, "File Layout"): scan lines, uncompressed or with RLE, ZIPS or ZIP, one part or several.
//!
//! Depth comes in few of the many forms that the format knows, and its crate brings a thread pool and features of shared crates for the rest.

mod header;
mod pixels;

use crate::error::{Result, VideoError};
use animimic_scene::DepthMap;
use header::{Bytes, Parsed, Part, size};
use pixels::place;
use std::path::Path;

/// First four bytes.
const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];
/// Flags of the version.
const TILED: u32 = 0x200;
const DEEP: u32 = 0x800;
const PARTS: u32 = 0x1000;
/// Channels that may hold depth, the likeliest first: a part of the name and how many parts stand behind it. Of a pass that is called
/// Depth the channel is Depth.V or Depth.Z; pictures of one channel call it Y, those of three alike R.
const CHANNELS: [(&str, usize); 6] = [("z", 0), ("depth", 0), ("depth", 1), ("v", 0), ("y", 0), ("r", 0)];

/// Reads the depth of one file: the channel that is called so, or the only one; half, single or whole numbers. Pixels of the picture
/// that the file has no data for are NaN, as are those that are not positive or farther than any surface.
pub fn read_exr(file: &Path) -> Result<DepthMap> {
    let bytes = std::fs::read(file).map_err(VideoError::io(file))?;
    parse(&bytes).map_err(|reason| VideoError::invalid(file, reason))
}

fn parse(all: &[u8]) -> Parsed<DepthMap> {
    let mut bytes = Bytes { all, at: 0 };
    if !all.starts_with(&MAGIC) {
        return Err("not an EXR file".into());
    }
    bytes.take(4)?;
    let version = bytes.i32()? as u32;
    if version & 0xff != 2 || version & DEEP != 0 {
        return Err("an EXR file of version 2 with one sample a pixel is needed, not a deep one: flatten it".into());
    }
    let mut parts = Vec::new();
    while let Some(part) = Part::read(&mut bytes)? {
        parts.push(part);
        if version & PARTS == 0 {
            break;
        }
    }
    let (index, channel) = depth_channel(&parts)?;
    let part = &parts[index];
    if version & TILED != 0 || !["", "scanlineimage"].contains(&part.kind.trim_end_matches('\0')) {
        return Err(
            "the EXR file is tiled or deep: save it as scan lines, as `oiiotool IN.exr --scanline -o OUT.exr` does"
                .into(),
        );
    }
    let chunks = |part: &Part| Ok::<_, String>((size(part.data)[1] as usize).div_ceil(part.lines_per_chunk()?));
    for before in &parts[..index] {
        bytes.take(8 * chunks(before)?)?;
    }
    let offsets = bytes.take(8 * chunks(part)?)?;
    let [width, height] = size(part.display).map(|s| s as usize);
    let mut map = DepthMap { width, height, values: vec![f32::NAN; width * height] };
    for offset in offsets.as_chunks::<8>().0 {
        let at = usize::try_from(u64::from_le_bytes(*offset)).unwrap_or(usize::MAX).min(all.len());
        let mut chunk = Bytes { all, at };
        if version & PARTS != 0 && chunk.i32()? != index as i32 {
            return Err("the parts of the EXR file are mixed up; write it again".into());
        }
        place(part, channel, &mut chunk, &mut map)?;
    }
    Ok(map)
}

/// Part and channel with depth, of all in the file.
fn depth_channel(parts: &[Part]) -> Parsed<(usize, usize)> {
    let mut all = Vec::new();
    for (p, part) in parts.iter().enumerate() {
        all.extend((0..part.channels.len()).map(|c| (p, c)));
    }
    let name = |&(p, c): &(usize, usize)| {
        let (part, channel) = (&parts[p].name, &parts[p].channels[c].name);
        if part.is_empty() { channel.to_lowercase() } else { format!("{part}.{channel}").to_lowercase() }
    };
    let names: Vec<String> = all.iter().map(name).collect();
    let called = |&(word, behind): &(&str, usize)| names.iter().position(|n| n.rsplit('.').nth(behind) == Some(word));
    let found = if all.len() == 1 { Some(0) } else { CHANNELS.iter().find_map(called) };
    let found = found.ok_or_else(|| {
        format!(
            "no channel of the EXR file is called Z or depth, there are {}: rename the one that is",
            names.join(", ")
        )
    })?;
    let (p, c) = all[found];
    let sound = parts[p].channels.iter().all(|c| (0..=2).contains(&c.kind) && c.sampling == [1; 2]);
    if !sound {
        return Err(
            "the EXR file has channels without a sample for every pixel: save the depth alone, at full size".into()
        );
    }
    Ok((p, c))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Name and kind of a channel, and its first value, to which 1 is added from sample to sample.
    type Samples<'a> = (&'a str, i32, f32);

    /// A file of 4x3 data at (1, 2) in a picture of 6x6.
    fn file(channels: &[Samples], compression: u8) -> Vec<u8> {
        let mut out = [&MAGIC[..], &2i32.to_le_bytes()].concat();
        let attribute = |out: &mut Vec<u8>, name: &str, kind: &str, value: &[u8]| {
            out.extend(
                [name.as_bytes(), b"\0", kind.as_bytes(), b"\0", &(value.len() as i32).to_le_bytes(), value].concat(),
            );
        };
        let words = |list: &[i32]| list.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
        let entry = |(name, kind, _): &Samples| [name.as_bytes(), b"\0", &words(&[*kind, 0, 1, 1])].concat();
        let list = [channels.iter().flat_map(entry).collect::<Vec<u8>>(), vec![0]].concat();
        attribute(&mut out, "channels", "chlist", &list);
        attribute(&mut out, "compression", "compression", &[compression]);
        attribute(&mut out, "dataWindow", "box2i", &words(&[1, 2, 4, 4]));
        attribute(&mut out, "displayWindow", "box2i", &words(&[0, 0, 5, 5]));
        out.push(0);
        let sample = |kind: i32, v: f32| match kind {
            0 => (v as u32).to_le_bytes().to_vec(),
            // Whole numbers from 1 to 2047 as halves.
            1 => ((((v.log2().floor() as u16) + 15) << 10) | ((v / v.log2().floor().exp2() - 1.0) * 1024.0) as u16)
                .to_le_bytes()
                .to_vec(),
            _ => v.to_le_bytes().to_vec(),
        };
        let line = |y: usize| -> Vec<u8> {
            channels
                .iter()
                .flat_map(|(_, kind, from)| (0..4).flat_map(move |x| sample(*kind, from + (4 * y + x) as f32)))
                .collect()
        };
        let chunks: Vec<(i32, Vec<u8>)> = if compression == 3 {
            vec![(2, (0..3).flat_map(line).collect())]
        } else {
            (0..3).map(|y| (2 + y as i32, line(y))).collect()
        };
        let mut at = out.len() + 8 * chunks.len();
        let mut blocks = Vec::new();
        for (y, pixels) in chunks {
            let split = pixels.iter().step_by(2).chain(pixels.iter().skip(1).step_by(2));
            let mut deltas: Vec<u8> = split.copied().collect();
            for i in (1..deltas.len()).rev() {
                deltas[i] = deltas[i].wrapping_sub(deltas[i - 1]).wrapping_add(128);
            }
            let packed = match compression {
                0 => pixels.clone(),
                1 => deltas.chunks(100).flat_map(|c| [vec![(-(c.len() as i8)) as u8], c.to_vec()].concat()).collect(),
                _ => miniz_oxide::deflate::compress_to_vec_zlib(&deltas, 6),
            };
            // What would not become smaller is stored as it is.
            let packed = if packed.len() < pixels.len() { packed } else { pixels };
            let block = [&y.to_le_bytes()[..], &(packed.len() as i32).to_le_bytes(), &packed].concat();
            out.extend((at as u64).to_le_bytes());
            at += block.len();
            blocks.extend(block);
        }
        [out, blocks].concat()
    }

    #[test]
    fn the_channel_with_depth_is_read_where_its_data_lies_whole_half_or_single() {
        let cases: [(&str, &[Samples]); 6] = [
            ("alone", &[("anything", 2, 5.0)]),
            ("half", &[("Y", 1, 5.0)]),
            ("beside colours", &[("B", 2, 90.0), ("G", 1, 90.0), ("R", 1, 90.0), ("Z", 1, 5.0)]),
            ("a pass", &[("ViewLayer.Combined.R", 2, 90.0), ("ViewLayer.Depth.V", 2, 5.0)]),
            ("grey in colours", &[("B", 1, 90.0), ("G", 2, 90.0), ("R", 2, 5.0)]),
            ("whole numbers", &[("A", 2, 90.0), ("depth", 0, 5.0)]),
        ];
        for (name, channels) in cases {
            for compression in 0..4 {
                let map = parse(&file(channels, compression)).expect(name);
                assert_eq!((map.width, map.height), (6, 6), "{name}");
                assert_eq!((map.values[2 * 6 + 1], map.values[4 * 6 + 4]), (5.0, 16.0), "{name}, {compression}");
                assert_eq!(map.values.iter().filter(|v| v.is_nan()).count(), 24, "{name}");
            }
        }
        let odd = parse(&file(&[("Z", 2, -3.0)], 3)).expect("reads");
        assert_eq!(odd.values.iter().filter(|v| **v > 0.0).count(), 8, "what is not positive is none");
        assert!(parse(&file(&[("Z", 2, 1e10)], 0)).expect("reads").values.iter().all(|v| v.is_nan()));
    }

    #[test]
    fn broken_and_unfit_files_are_refused_in_one_sentence() {
        let sound = file(&[("Z", 2, 5.0)], 3);
        let with = |from: &[u8], to: &[u8]| {
            let at = sound.windows(from.len()).position(|w| w == from).expect("there");
            [&sound[..at], to, &sound[at + from.len()..]].concat()
        };
        let window = [b"box2i\0\x10\0\0\0".as_slice(), &1i32.to_le_bytes(), &2i32.to_le_bytes()].concat();
        let huge = with(
            &[window.as_slice(), &4i32.to_le_bytes()].concat(),
            &[&window[..], &2_000_000_000i32.to_le_bytes()].concat(),
        );
        let cut = sound[..sound.len() - 9].to_vec();
        for (name, bytes, told) in [
            ("empty", Vec::new(), "not an EXR file"),
            ("garbage", b"<html>not found</html>".to_vec(), "not an EXR file"),
            ("cut", cut, "ends at byte"),
            ("no depth", file(&[("u", 2, 5.0), ("w", 2, 5.0)], 0), "Z or depth, there are u, w"),
            ("huge", huge, "at most 16384 px"),
            (
                "piz",
                with(b"compression\0compression\0\x01\0\0\0\x03", b"compression\0compression\0\x01\0\0\0\x04"),
                "is PIZ: save it with ZIP",
            ),
            (
                "tiled",
                with(&[&MAGIC[..], &2i32.to_le_bytes()].concat(), &[&MAGIC[..], &0x202i32.to_le_bytes()].concat()),
                "scan lines",
            ),
            (
                "half the samples",
                with(
                    &[1i32.to_le_bytes(), 1i32.to_le_bytes()].concat(),
                    &[2i32.to_le_bytes(), 1i32.to_le_bytes()].concat(),
                ),
                "full size",
            ),
        ] {
            let said = parse(&bytes).expect_err(name);
            println!("{name}: {said}");
            assert!(said.contains(told) && said.lines().count() == 1, "{name}: {said}");
        }
    }
}

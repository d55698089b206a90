//! Masks: folders of PNGs and npz archives.

use super::{any, opened, pictures, saved};
use crate::error::{Result, VideoError};
use crate::pixels::open_image;
use crate::write::write_mask_png;
use animimic_scene::Mask;
use animimic_scene::io::npz::{Archive, Values};
use std::path::Path;

/// Values up to here are numbers of objects, not shades: no shade of a mask stays so dark throughout a video.
const MOST_OBJECTS: f32 = 127.0;

/// Reads masks from a folder of PNGs or from an npz.
///
/// PNGs: alpha where they have any, else brightness; pictures in colours or dark throughout are label maps (as SAM 2 and DAVIS write them),
/// in which everything but black is the object.
///
/// npz: `masks`, `main`, `mask` or `segmentations`, `[T,H,W]` or `[T,N,H,W]` of N objects, of which the union is taken: truth values,
/// shares in \[0, 1\], shades to 255, labels, or logits (with negative values; positive is inside). `[T,H,W]` of bytes may be packed along
/// x as `numpy.packbits` does (`width` or `shape` state the true width, else 8·bytes).
pub fn read_masks(path: &Path) -> Result<Vec<Mask>> {
    if path.is_dir() {
        let files = pictures(path, "png")?;
        return Ok(from_shades(files.iter().map(|f| read_mask_png(f)).collect::<Result<_>>()?));
    }
    let archive = opened(path)?;
    let array = any(path, &archive, &["masks", "main", "mask", "segmentations"])?;
    let [n, objects, h, stride] = match array.squeezed(3)[..] {
        [n, h, w] => [n, 1, h, w],
        [n, objects, h, w] => [n, objects, h, w],
        _ => {
            let what = format!("{} must be [T,H,W] or [T,N,H,W], not {:?}", array.name, array.shape);
            return Err(VideoError::invalid(path, what));
        }
    };
    let bytes = archive.get(array.name).is_some_and(|a| matches!(a.values, Values::U8(_)));
    if let Some(width) = packed_width(&archive, &array.values, stride).filter(|_| bytes && objects == 1) {
        return Ok((0..n).map(|t| unpacked(&array.values[t * h * stride..], width, h, stride)).collect());
    }
    let coverage = coverage_of(&array.values);
    let size = h * stride;
    let union = |t: usize, i: usize| {
        (0..objects).map(|k| array.values[(t * objects + k) * size + i]).fold(f32::NEG_INFINITY, f32::max)
    };
    let mask = |t: usize| (0..size).map(|i| coverage(union(t, i))).collect();
    Ok((0..n).map(|t| Mask { width: stride, height: h, coverage: mask(t) }).collect())
}

/// How the values of masks are to be understood, by their range.
fn coverage_of(values: &[f32]) -> impl Fn(f32) -> u8 + use<> {
    let range = values.iter().filter(|v| v.is_finite());
    let (low, high) = range.fold((0.0f32, 0.0f32), |(l, h), &v| (l.min(v), h.max(v)));
    let whole = values.iter().all(|v| v.fract() == 0.0);
    move |v: f32| {
        if low < 0.0 || (whole && high <= MOST_OBJECTS) {
            if v > 0.0 { 255 } else { 0 }
        } else if high <= 1.0 {
            (255.0 * v).round() as u8
        } else {
            v.clamp(0.0, 255.0) as u8
        }
    }
}

/// The true width of bytes that hold eight pixels each; `None` where they hold one.
fn packed_width(archive: &Archive, values: &[f32], stride: usize) -> Option<usize> {
    let stated = |name: &str, k: usize| archive.get(name).and_then(|a| a.to_f64().get(k).copied()).map(|v| v as usize);
    match stated("width", 0).or_else(|| stated("shape", 2)) {
        Some(width) => (width.div_ceil(8) == stride && width != stride).then_some(width),
        // Without a stated width, bytes are packed bits only if other values than 0, 1 and 255 occur.
        None => values.iter().any(|v| ![0.0, 1.0, 255.0].contains(v)).then_some(8 * stride),
    }
}

fn unpacked(bytes: &[f32], width: usize, height: usize, stride: usize) -> Mask {
    let bit = |x: usize, y: usize| bytes[y * stride + x / 8] as u8 >> (7 - x % 8) & 1;
    Mask { width, height, coverage: (0..width * height).map(|i| 255 * bit(i % width, i / width)).collect() }
}

/// Brightness of a picture, or 0 and 255 where it is in colours.
fn read_mask_png(file: &Path) -> Result<Mask> {
    let image = open_image(file)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let coverage = if image.color().has_alpha() {
        image.into_rgba8().pixels().map(|p| p.0[3]).collect()
    } else {
        let rgb = image.into_rgb8();
        let colored = rgb.pixels().any(|p| p.0[0] != p.0[1] || p.0[1] != p.0[2]);
        let shade = |p: &image::Rgb<u8>| if colored { 255 * u8::from(p.0 != [0; 3]) } else { p.0[0] };
        rgb.pixels().map(shade).collect()
    };
    Ok(Mask { width, height, coverage })
}

/// Shades as they are, unless all are so dark that they are labels.
fn from_shades(mut masks: Vec<Mask>) -> Vec<Mask> {
    let brightest = masks.iter().flat_map(|m| &m.coverage).copied().max().unwrap_or(0);
    if f32::from(brightest) <= MOST_OBJECTS {
        masks.iter_mut().flat_map(|m| &mut m.coverage).for_each(|c| *c = 255 * u8::from(*c > 0));
    }
    masks
}

/// Writes masks as `00000.png`, … into a folder, or as a packed npz (`masks`, `width`, `height`) when the path ends so.
pub fn write_masks(path: &Path, masks: &[Mask]) -> Result<()> {
    let (w, h) =
        masks.first().map(|m| (m.width, m.height)).ok_or_else(|| VideoError::Caller("no masks to write".into()))?;
    if path.extension().is_none_or(|e| e != "npz") {
        std::fs::create_dir_all(path).map_err(VideoError::io(path))?;
        return masks.iter().enumerate().try_for_each(|(t, m)| write_mask_png(&path.join(format!("{t:05}.png")), m));
    }
    if let Some(t) = masks.iter().position(|m| (m.width, m.height) != (w, h)) {
        return Err(VideoError::Caller(format!("mask {t} has another size than mask 0")));
    }
    saved(
        path,
        vec![
            ("masks", vec![masks.len(), h, w.div_ceil(8)], Values::U8(packed_bits(masks))),
            ("width", vec![], Values::I64(vec![w as i64])),
            ("height", vec![], Values::I64(vec![h as i64])),
        ],
    )
}

/// Inside or not, \[frame\]\[row\], eight pixels a byte, highest bit first (`numpy.packbits` along x). All masks have one size.
pub fn packed_bits(masks: &[Mask]) -> Vec<u8> {
    let rows = masks.iter().flat_map(|m| (0..m.height).map(move |y| (m, y)));
    let byte = |m: &Mask, y: usize, b: usize| {
        (8 * b..m.width.min(8 * b + 8)).filter(|&x| m.inside(x, y)).fold(0u8, |bits, x| bits | 128 >> (x % 8))
    };
    rows.flat_map(|(m, y)| (0..m.width.div_ceil(8)).map(move |b| byte(m, y, b))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(t: usize) -> Mask {
        let coverage = (0..189).map(|i| if (i + t) % 5 < 2 { 255 } else { 0 }).collect();
        Mask { width: 21, height: 9, coverage }
    }

    #[test]
    fn masks_survive_both_formats() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let masks: Vec<Mask> = (0..4).map(mask).collect();
        for name in ["masks.npz", "masks"] {
            let path = folder.path().join(name);
            write_masks(&path, &masks).expect("writes");
            assert_eq!(read_masks(&path).expect("reads"), masks, "{name}");
        }
        let soft = vec![Mask { width: 4, height: 1, coverage: vec![0, 60, 128, 255] }];
        write_masks(&folder.path().join("soft"), &soft).expect("writes");
        assert_eq!(read_masks(&folder.path().join("soft")).expect("reads"), soft);
    }

    #[test]
    fn truth_labels_shares_logits_and_several_objects_are_understood() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("other.npz");
        let read = |shape: Vec<usize>, values: Values| {
            saved(&path, vec![("masks", shape, values)]).expect("writes");
            read_masks(&path).expect("reads").into_iter().map(|m| m.coverage).collect::<Vec<_>>()
        };
        let on = vec![vec![0, 255, 255, 0]];
        assert_eq!(read(vec![1, 2, 2], Values::Bool(vec![false, true, true, false])), on);
        assert_eq!(read(vec![1, 2, 2], Values::I32(vec![0, 2, 7, 0])), on);
        assert_eq!(read(vec![1, 2, 2], Values::F32(vec![-9.0, 3.0, 0.5, -0.1])), on);
        assert_eq!(read(vec![1, 2, 2], Values::F32(vec![0.0, 1.0, 0.5, 0.2])), [[0, 255, 128, 51]]);
        assert_eq!(read(vec![1, 2, 2], Values::U8(vec![0, 255, 255, 0])), on);
        assert_eq!(read(vec![1, 1, 2, 2], Values::U8(vec![0, 1, 1, 0])), on);
        let two = Values::Bool(vec![false, true, false, false, false, false, true, false]);
        assert_eq!(read(vec![2, 2, 1, 2], two), [[0, 255], [255, 0]]);
    }

    #[test]
    fn label_maps_in_colours_or_small_numbers_are_all_object_but_for_black() {
        let folder = tempfile::tempdir().expect("temporary folder");
        // A palette as DAVIS has it: black, dark red, dark green.
        let (mut file, path) = (Vec::new(), folder.path().join("0.png"));
        let chunk = |kind: &[u8], data: &[u8]| {
            let body = [kind, data].concat();
            let sum = body.iter().fold(!0u32, |c, &b| {
                (0..8).fold(c ^ u32::from(b), |c, _| if c & 1 == 1 { 0xEDB8_8320 ^ (c >> 1) } else { c >> 1 })
            });
            [&(data.len() as u32).to_be_bytes()[..], &body, &(!sum).to_be_bytes()].concat()
        };
        file.extend(b"\x89PNG\r\n\x1a\n");
        file.extend(chunk(b"IHDR", &[0, 0, 0, 3, 0, 0, 0, 1, 8, 3, 0, 0, 0]));
        file.extend(chunk(b"PLTE", &[0, 0, 0, 128, 0, 0, 0, 128, 0]));
        // Stored deflate: one block of four bytes (filter, three indices), then Adler-32.
        file.extend(chunk(b"IDAT", &[0x78, 1, 1, 4, 0, 0xfb, 0xff, 0, 0, 1, 2, 0, 8, 0, 4]));
        file.extend(chunk(b"IEND", &[]));
        std::fs::write(&path, file).expect("written");
        assert_eq!(read_masks(folder.path()).expect("reads")[0].coverage, [0, 255, 255]);
        let labels = Mask { width: 3, height: 1, coverage: vec![0, 1, 2] };
        write_mask_png(&path, &labels).expect("writes");
        assert_eq!(read_masks(folder.path()).expect("reads")[0].coverage, [0, 255, 255]);
    }
}

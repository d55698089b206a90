//! Cue files, ours and those of other programs: masks (PNG folder, packed npz), tracks (npz), depth (npz, 16-bit PNG).

use crate::error::{Result, VideoError};
use crate::pixels::open_image;
use crate::write::{encode_png, write_mask_png, write_whole};
use animimic_scene::io::npz::{Archive, Array, Values, read as read_npz, write as write_npz};
use animimic_scene::{DepthKind, DepthMap, Mask, Tracks};
use std::path::{Path, PathBuf};

fn opened(path: &Path) -> Result<Archive> {
    read_npz(path).map_err(|e| VideoError::invalid(path, e.to_string()))
}

fn saved(path: &Path, arrays: Vec<(&str, Vec<usize>, Values)>) -> Result<()> {
    let arrays = arrays.into_iter().map(|(name, shape, values)| (name.to_string(), Array { shape, values })).collect();
    write_npz(path, &Archive { arrays }).map_err(|e| VideoError::invalid(path, e.to_string()))
}

/// The array of the first name that is there.
fn any<'a>(path: &Path, archive: &'a Archive, names: &[&str]) -> Result<&'a Array> {
    names.iter().find_map(|n| archive.get(n)).ok_or_else(|| {
        let found: Vec<&str> = archive.arrays.iter().map(|(n, _)| n.as_str()).collect();
        VideoError::invalid(
            path,
            format!("none of the arrays {} is there, only {}", names.join(", "), found.join(", ")),
        )
    })
}

/// The pictures of a folder in order of their names.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(VideoError::io(folder))? {
        let file = entry.map_err(VideoError::io(folder))?.path();
        if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
            files.push(file);
        }
    }
    crate::source::folder::sort_naturally(&mut files);
    if files.is_empty() { Err(VideoError::invalid(folder, "the folder holds no PNG pictures")) } else { Ok(files) }
}

/// Reads masks from a folder of PNGs (alpha if it has any, else brightness) or an npz: `masks` or `main`, either
/// `[T,H,W]` or packed along x as `numpy.packbits` does (`width` or `shape` state the true width, else 8·bytes).
pub fn read_masks(path: &Path) -> Result<Vec<Mask>> {
    if path.is_dir() {
        return pictures(path)?.iter().map(|f| read_mask_png(f)).collect();
    }
    let archive = opened(path)?;
    let array = any(path, &archive, &["masks", "main", "mask"])?;
    let [n, h, stride] = array.shape[..] else {
        return Err(VideoError::invalid(path, format!("masks must be [T,H,W], not {:?}", array.shape)));
    };
    let stated = |name: &str, k: usize| archive.get(name).and_then(|a| a.to_f64().get(k).copied()).map(|v| v as usize);
    let width = stated("width", 0).or_else(|| stated("shape", 2));
    let values = array.to_f32();
    let packed = matches!(array.values, Values::U8(_)) && width.is_none_or(|w| w.div_ceil(8) == stride && w != stride);
    // Without a stated width, bytes are packed bits only if other values than 0, 1 and 255 occur.
    let packed = packed && (width.is_some() || values.iter().any(|v| ![0.0, 1.0, 255.0].contains(v)));
    let w = if packed { width.unwrap_or(8 * stride) } else { stride };
    let scale = if values.iter().any(|&v| v > 1.0) { 1.0 } else { 255.0 };
    let masks = (0..n).map(|t| {
        let at = |x: usize, y: usize| -> u8 {
            if packed {
                let byte = values[(t * h + y) * stride + x / 8] as u8;
                255 * (byte >> (7 - x % 8) & 1)
            } else {
                (scale * values[(t * h + y) * stride + x]).clamp(0.0, 255.0) as u8
            }
        };
        Mask { width: w, height: h, coverage: (0..w * h).map(|i| at(i % w, i / w)).collect() }
    });
    Ok(masks.collect())
}

fn read_mask_png(file: &Path) -> Result<Mask> {
    let image = open_image(file)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let coverage = if image.color().has_alpha() {
        image.into_rgba8().pixels().map(|p| p.0[3]).collect()
    } else {
        image.into_luma8().into_raw()
    };
    Ok(Mask { width, height, coverage })
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

/// Reads tracks: `tracks` \[T,N,2\] [px], `visibility` \[T,N\] (truth values or confidence), `queries` \[N\] or \[N,≥1\]
/// (first column: frame) if there. A leading axis of length 1 (batch) is dropped.
pub fn read_tracks(path: &Path) -> Result<Tracks> {
    let archive = opened(path)?;
    let array = any(path, &archive, &["tracks", "trajs", "pred_tracks"])?;
    let shape = if array.shape.len() == 4 && array.shape[0] == 1 { &array.shape[1..] } else { &array.shape[..] };
    let [frames, points, 2] = *shape else {
        return Err(VideoError::invalid(path, format!("tracks must be [T,N,2], not {:?}", array.shape)));
    };
    let xy = array.to_f32();
    let visible = any(path, &archive, &["visibility", "visibilities", "visibs", "pred_visibility"]).map(Array::to_f32);
    let visible = visible.unwrap_or_else(|_| vec![1.0; frames * points]);
    if visible.len() != frames * points || xy.len() != 2 * frames * points {
        return Err(VideoError::invalid(
            path,
            "visibility and tracks do not have the same number of frames and points",
        ));
    }
    let query_frame = match archive.get("queries") {
        Some(q) if points > 0 => {
            let columns = q.to_f32().len() / points;
            (0..points).map(|k| q.to_f32().get(k * columns.max(1)).map_or(0, |v| v.max(0.0) as u32)).collect()
        }
        _ => vec![0; points],
    };
    let row = |t: usize| t * points..(t + 1) * points;
    let pixel = |i: usize| [xy[2 * i], xy[2 * i + 1]];
    let sound = |i: usize| pixel(i).iter().all(|v| v.is_finite()) && visible[i].is_finite();
    Ok(Tracks {
        pixels: (0..frames).map(|t| row(t).map(|i| if sound(i) { pixel(i) } else { [0.0; 2] }).collect()).collect(),
        confidence: (0..frames)
            .map(|t| row(t).map(|i| if sound(i) { visible[i].clamp(0.0, 1.0) } else { 0.0 }).collect())
            .collect(),
        query_frame,
    })
}

/// Writes tracks as [`read_tracks`] reads them; `visibility` holds the confidence.
pub fn write_tracks(path: &Path, tracks: &Tracks) -> Result<()> {
    let (frames, points) = (tracks.pixels.len(), tracks.query_frame.len());
    saved(
        path,
        vec![
            (
                "tracks",
                vec![frames, points, 2],
                Values::F32(tracks.pixels.iter().flatten().flatten().copied().collect()),
            ),
            ("visibility", vec![frames, points], Values::F32(tracks.confidence.iter().flatten().copied().collect())),
            ("queries", vec![points], Values::I64(tracks.query_frame.iter().map(|&q| i64::from(q)).collect())),
        ],
    )
}

/// Reads depth: a folder of 16-bit PNGs (0 = none) or an npz with `depth` \[T,H,W\] (NaN, infinity or ≤ 0 = none).
/// What the values mean is `kind`, unless the npz says so itself (`kind`: 0 metric, 1 inverse).
pub fn read_depth(path: &Path, kind: DepthKind) -> Result<(Vec<DepthMap>, DepthKind)> {
    let sound = |v: f32| if v.is_finite() && v > 0.0 { v } else { f32::NAN };
    if path.is_dir() {
        let map = |file: &PathBuf| -> Result<DepthMap> {
            let image = open_image(file)?.into_luma16();
            let (width, height) = (image.width() as usize, image.height() as usize);
            Ok(DepthMap { width, height, values: image.into_raw().into_iter().map(|v| sound(f32::from(v))).collect() })
        };
        return Ok((pictures(path)?.iter().map(map).collect::<Result<_>>()?, kind));
    }
    let archive = opened(path)?;
    let array = any(path, &archive, &["depth", "depths", "disparity"])?;
    let [n, height, width] = array.shape[..] else {
        return Err(VideoError::invalid(path, format!("depth must be [T,H,W], not {:?}", array.shape)));
    };
    let stated = archive.get("kind").and_then(|a| a.to_f64().first().copied());
    let kind = match stated {
        Some(1.0) => DepthKind::Inverse,
        Some(_) => DepthKind::Metric,
        None => kind,
    };
    let values = array.to_f32();
    let size = width * height;
    let map = |t: usize| DepthMap {
        width,
        height,
        values: values[t * size..(t + 1) * size].iter().map(|&v| sound(v)).collect(),
    };
    Ok(((0..n).map(map).collect(), kind))
}

/// Writes depth as npz (`depth`, `kind`), or as 16-bit PNGs into a folder: values scaled so that the largest is 65535.
pub fn write_depth(path: &Path, maps: &[DepthMap], kind: DepthKind) -> Result<()> {
    let (w, h) =
        maps.first().map(|m| (m.width, m.height)).ok_or_else(|| VideoError::Caller("no depth to write".into()))?;
    if path.extension().is_some_and(|e| e == "npz") {
        let kind = i64::from(kind == DepthKind::Inverse);
        let values = maps.iter().flat_map(|m| m.values.iter().copied()).collect();
        return saved(
            path,
            vec![("depth", vec![maps.len(), h, w], Values::F32(values)), ("kind", vec![], Values::I64(vec![kind]))],
        );
    }
    std::fs::create_dir_all(path).map_err(VideoError::io(path))?;
    let largest =
        maps.iter().flat_map(|m| &m.values).copied().filter(|v| v.is_finite()).fold(0.0f32, f32::max).max(1e-30);
    for (t, map) in maps.iter().enumerate() {
        let sample =
            |&v: &f32| if v.is_finite() && v > 0.0 { (v / largest * 65535.0).round().max(1.0) as u16 } else { 0 };
        let samples: Vec<u8> = map.values.iter().map(sample).flat_map(u16::to_ne_bytes).collect();
        let png = encode_png(&samples, map.width, map.height, image::ExtendedColorType::L16)?;
        write_whole(&path.join(format!("{t:05}.png")), &png)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_tracks_and_depth_survive_every_format() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let mask = |t: usize| Mask {
            width: 21,
            height: 9,
            coverage: (0..189).map(|i| if (i + t) % 5 < 2 { 255 } else { 0 }).collect(),
        };
        let masks: Vec<Mask> = (0..4).map(mask).collect();
        for name in ["masks.npz", "masks"] {
            let path = folder.path().join(name);
            write_masks(&path, &masks).expect("writes");
            assert_eq!(read_masks(&path).expect("reads"), masks, "{name}");
        }
        let tracks = Tracks {
            pixels: vec![vec![[1.5, 2.5], [3.25, 4.0]]; 3],
            confidence: vec![vec![0.5, 1.0], vec![0.0, 0.25], vec![1.0, 0.0]],
            query_frame: vec![0, 2],
        };
        let path = folder.path().join("tracks.npz");
        write_tracks(&path, &tracks).expect("writes");
        let back = read_tracks(&path).expect("reads");
        assert_eq!(
            (back.pixels, back.confidence, back.query_frame),
            (tracks.pixels, tracks.confidence, tracks.query_frame)
        );
        let values: Vec<f32> = (0..12).map(|i| if i == 5 { f32::NAN } else { 1.0 + i as f32 }).collect();
        let maps = vec![DepthMap { width: 4, height: 3, values }];
        for name in ["depth.npz", "depth"] {
            let path = folder.path().join(name);
            write_depth(&path, &maps, DepthKind::Inverse).expect("writes");
            let (back, kind) = read_depth(&path, DepthKind::Inverse).expect("reads");
            assert_eq!(kind, DepthKind::Inverse);
            let ratio = back[0].values[11] / back[0].values[0];
            println!("{name}: {ratio}");
            assert!((ratio - 12.0).abs() < 2e-3 && back[0].values[5].is_nan());
        }
    }

    #[test]
    fn wrong_shapes_and_names_are_refused_with_what_is_there() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("odd.npz");
        saved(&path, vec![("tracks", vec![2, 3], Values::F32(vec![0.0; 6]))]).expect("writes");
        assert!(read_tracks(&path).expect_err("refused").to_string().contains("[2, 3]"));
        assert!(read_masks(&path).expect_err("refused").to_string().contains("only tracks"));
        assert!(read_depth(&folder.path().join("absent.npz"), DepthKind::Metric).is_err());
    }
}

//! Depth: npz archives, folders of 16-bit PNGs or of EXRs.

use super::exr::read_exr;
use super::{any, files_ending, opened, pictures, saved};
use crate::error::{Result, VideoError};
use crate::pixels::open_image;
use crate::write::{encode_samples, write_whole};
use animimic_scene::io::npz::Values;
use animimic_scene::{DepthKind, DepthMap};
use std::path::{Path, PathBuf};

/// Reads depth: a folder of 8- or 16-bit PNGs (0 = none), a folder of EXRs, or an npz with `depth` or `depths` \[T,H,W\] (NaN, infinity or ≤ 0 = none); a
/// batch in front and a channel at the end, both of length 1, are dropped (as VGGT has them).
///
/// What the values mean is `kind` where given; else what the npz says (`kind`: 0 metric, 1 inverse; an array called `disparity` is inverse),
/// else metric.
pub fn read_depth(path: &Path, kind: Option<DepthKind>) -> Result<(Vec<DepthMap>, DepthKind)> {
    let sound = |v: f32| if v.is_finite() && v > 0.0 { v } else { f32::NAN };
    if path.is_dir() {
        let floats = files_ending(path, "exr")?;
        if !floats.is_empty() {
            if !files_ending(path, "png")?.is_empty() {
                let what = "the folder holds EXR and PNG pictures: put those that are not depth elsewhere";
                return Err(VideoError::invalid(path, what));
            }
            return Ok((floats.iter().map(|f| read_exr(f)).collect::<Result<_>>()?, kind.unwrap_or_default()));
        }
        let map = |file: &PathBuf| -> Result<DepthMap> {
            let image = open_image(file)?.into_luma16();
            let (width, height) = (image.width() as usize, image.height() as usize);
            Ok(DepthMap { width, height, values: image.into_raw().into_iter().map(|v| sound(f32::from(v))).collect() })
        };
        return Ok((pictures(path, "png")?.iter().map(map).collect::<Result<_>>()?, kind.unwrap_or_default()));
    }
    let archive = opened(path)?;
    let array = any(path, &archive, &["depth", "depths", "depth_map", "disparity"])?;
    let [n, height, width] = array.squeezed(3)[..] else {
        return Err(VideoError::invalid(path, format!("{} must be [T,H,W], not {:?}", array.name, array.shape)));
    };
    let stated = archive.get("kind").and_then(|a| a.to_f64().first().copied());
    let own = match stated {
        Some(1.0) => DepthKind::Inverse,
        Some(_) => DepthKind::Metric,
        None if array.name == "disparity" => DepthKind::Inverse,
        None => DepthKind::default(),
    };
    let size = width * height;
    let values = |t: usize| array.values[t * size..(t + 1) * size].iter().map(|&v| sound(v)).collect();
    Ok(((0..n).map(|t| DepthMap { width, height, values: values(t) }).collect(), kind.unwrap_or(own)))
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
        let png = encode_samples(&samples, map.width, map.height, image::ExtendedColorType::L16)?;
        write_whole(&path.join(format!("{t:05}.png")), &png)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_survives_both_formats_and_says_what_it_means() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let values: Vec<f32> = (0..12).map(|i| if i == 5 { f32::NAN } else { 1.0 + i as f32 }).collect();
        let maps = vec![DepthMap { width: 4, height: 3, values }];
        for name in ["depth.npz", "depth"] {
            let path = folder.path().join(name);
            write_depth(&path, &maps, DepthKind::Inverse).expect("writes");
            // A PNG cannot say what it means.
            let asked = (name == "depth").then_some(DepthKind::Inverse);
            let (back, kind) = read_depth(&path, asked).expect("reads");
            assert_eq!(kind, DepthKind::Inverse);
            let ratio = back[0].values[11] / back[0].values[0];
            println!("{name}: {ratio}");
            assert!((ratio - 12.0).abs() < 2e-3 && back[0].values[5].is_nan());
            assert_eq!(read_depth(&path, Some(DepthKind::Metric)).expect("reads").1, DepthKind::Metric);
        }
        let path = folder.path().join("other.npz");
        let floats = || Values::F32((0..12).map(|i| i as f32).collect());
        saved(&path, vec![("depth", vec![1, 2, 2, 3, 1], floats())]).expect("writes");
        let (vggt, kind) = read_depth(&path, None).expect("reads");
        assert_eq!((vggt.len(), vggt[1].width, vggt[1].values[0], kind), (2, 3, 6.0, DepthKind::Metric));
        saved(&path, vec![("disparity", vec![2, 2, 3], floats())]).expect("writes");
        assert_eq!(read_depth(&path, None).expect("reads").1, DepthKind::Inverse);
    }
}

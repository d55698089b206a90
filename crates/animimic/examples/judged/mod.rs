//! Files for judges outside: models on the command line, GLBs with what is expected of them in a folder.

use animimic::scene::io::npz::{Array, Values};
use animimic::scene::{Asset, Motion, io};
use glam::DVec3;
use std::path::Path;

/// Frames per second of all clips.
pub const FPS: f64 = 24.0;
/// Moments of a clip that are compared.
pub const SAMPLES: usize = 5;

pub type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Reads the arguments `OUT_DIR MODEL…`, does `work` on each model that bends and prints the names that it returns, each with its
/// model; `work` gets the beginning of those names too.
pub fn each_model(program: &str, work: impl Fn(&Asset, &Path, &str, &Path) -> Result<Vec<String>>) -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or_else(|| format!("usage: {program} OUT_DIR MODEL…"))?;
    for model in arguments {
        match one(Path::new(&model), |asset, name| work(asset, Path::new(&model), name, Path::new(&folder))) {
            Ok(names) => names.iter().for_each(|name| println!("{name}\t{model}")),
            Err(e) => println!("left out: {model}: {e}"),
        }
    }
    Ok(())
}

fn one(model: &Path, work: impl Fn(&Asset, &str) -> Result<Vec<String>>) -> Result<Vec<String>> {
    let asset = io::read(model)?;
    if !asset.rig.is_articulated() {
        return Err("has no skeleton".into());
    }
    let words: Vec<String> =
        model.components().rev().take(2).map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
    work(&asset, &format!("{}_{}", words[1], words[0].replace('.', "_")))
}

/// Surfaces of a motion \[frame\]\[vertex\].
pub fn posed(asset: &Asset, motion: &Motion) -> Vec<Vec<DVec3>> {
    motion.poses.iter().map(|p| asset.rig.in_pose(p)).collect()
}

/// The frames of a clip that are compared: first, last and evenly between.
pub fn picked(frames: usize) -> Vec<usize> {
    (0..SAMPLES).map(|s| s * (frames - 1) / (SAMPLES - 1)).collect()
}

/// A named array.
pub fn array(name: &str, shape: &[usize], values: Vec<f64>) -> (String, Array) {
    (name.to_owned(), Array { shape: shape.to_vec(), values: Values::F64(values) })
}

/// The arrays of clip number `k`: times and vertices at the frames that are compared.
pub fn sampled(k: usize, surfaces: &[Vec<DVec3>]) -> [(String, Array); 2] {
    let frames = picked(surfaces.len());
    let vertices = frames.iter().flat_map(|&f| flat(&surfaces[f])).collect();
    [
        array(&format!("clip_{k}_times"), &[SAMPLES], frames.iter().map(|&f| f as f64 / FPS).collect()),
        array(&format!("clip_{k}_vertices"), &[SAMPLES, surfaces[0].len(), 3], vertices),
    ]
}

/// Coordinates one after the other.
pub fn flat(points: &[DVec3]) -> Vec<f64> {
    points.iter().flat_map(|p| p.to_array()).collect()
}

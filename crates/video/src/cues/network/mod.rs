//! Masks and depth by a neural network in an ONNX file.
//!
//! The program ships no network: the user names a file, and a [`Preset`] says how its family of networks is fed. The pure-Rust runtime
//! is in builds with the feature `neural`; without it everything here stays but [`Network::masks`] and [`Network::depth`] say what to do.

mod presets;
mod resample;
#[cfg(feature = "neural")]
mod runtime;
#[cfg(not(feature = "neural"))]
#[path = "no_runtime.rs"]
mod runtime;
#[cfg(feature = "neural")]
mod wire;

pub use presets::{Gives, PRESETS, Preset};

use crate::error::Result;
use animimic_scene::{DepthMap, Mask, Video};
use std::path::{Path, PathBuf};

/// What stands before the path of a network where a source of cues is named.
pub const SCHEME: &str = "onnx:";

/// A network and how it is fed.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// The ONNX file.
    pub file: PathBuf,
    /// The family that it belongs to.
    pub preset: &'static Preset,
}

/// Where masks or depth come from that are not found by the program itself.
#[derive(Clone, Debug, PartialEq)]
pub enum CueSource {
    /// A file or folder that another program made.
    File(PathBuf),
    /// A network that is run.
    Network(Network),
}

impl CueSource {
    /// Reads `onnx:FILE`, `onnx:FILE:PRESET`, or the path of a file or folder. Without a preset the file's name tells, if a preset's name
    /// is in it; else it is the first that gives such cues.
    ///
    /// # Errors
    /// An unknown preset, or one that gives other cues.
    pub fn parse(text: &str, gives: Gives) -> std::result::Result<Self, String> {
        let Some(rest) = text.strip_prefix(SCHEME) else { return Ok(Self::File(text.into())) };
        let fitting = || PRESETS.iter().filter(|p| p.gives == gives);
        let (file, named) = match rest.rsplit_once(':') {
            // What holds a dot or a slash is a part of the path.
            Some((file, preset)) if !preset.contains(['.', '/', '\\']) => (file, Some(preset)),
            _ => (rest, None),
        };
        let preset = match named {
            Some(name) => fitting().find(|p| p.name == name).ok_or_else(|| {
                let names: Vec<&str> = fitting().map(|p| p.name).collect();
                format!("no preset for {} is called {name:?}: there are {}", gives.word(), names.join(", "))
            })?,
            None => {
                let stem = Path::new(file).file_name().unwrap_or_default().to_string_lossy().to_lowercase();
                let stem = stem.replace('_', "-");
                let told = fitting().find(|p| stem.contains(p.name));
                told.or_else(|| fitting().next()).expect("every kind of cue has a preset")
            }
        };
        if file.is_empty() {
            return Err("name the file: onnx:FILE or onnx:FILE:PRESET".into());
        }
        Ok(Self::Network(Network { file: file.into(), preset }))
    }

    /// The file or folder that is read.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Network(network) => &network.file,
        }
    }

    /// The same with another path.
    pub fn at(&self, path: PathBuf) -> Self {
        match self {
            Self::File(_) => Self::File(path),
            Self::Network(network) => Self::Network(Network { file: path, ..*network }),
        }
    }
}

/// One picture of numbers, row by row.
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Network {
    /// Coverage in every frame, of the video's size. The network's values are stretched over the whole video so that their extremes are
    /// 0 and 1, as u2net's and isnet's own programs do for a single picture.
    ///
    /// # Errors
    /// A build without networks; a file that is absent, no ONNX, or of the wrong shape.
    pub fn masks(&self, video: &Video) -> Result<Vec<Mask>> {
        let planes = runtime::run(self, &video.frames)?;
        let values = planes.iter().flat_map(|p| &p.values);
        let (low, high) = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        let scale = 255.0 / (high - low).max(f32::MIN_POSITIVE);
        let mask = |(plane, frame): (&Plane, &animimic_scene::Image)| {
            let (width, height) = (frame.width, frame.height);
            let values = resample::resampled(&plane.values, (plane.width, plane.height), (width, height));
            let coverage = values.into_iter().map(|v| (scale * (v - low)).round() as u8).collect();
            Mask { width, height, coverage }
        };
        Ok(planes.iter().zip(&video.frames).map(mask).collect())
    }

    /// Depth in every frame, of the network's own size; NaN where it is not positive.
    ///
    /// # Errors
    /// As [`Network::masks`].
    pub fn depth(&self, video: &Video) -> Result<Vec<DepthMap>> {
        let sound = |v: f32| if v.is_finite() && v > 0.0 { v } else { f32::NAN };
        let map =
            |p: Plane| DepthMap { width: p.width, height: p.height, values: p.values.into_iter().map(sound).collect() };
        Ok(runtime::run(self, &video.frames)?.into_iter().map(map).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_a_path_or_a_network_whose_family_is_named_or_told_by_its_file() {
        let network = |text: &str, gives| match CueSource::parse(text, gives) {
            Ok(CueSource::Network(n)) => (n.file.display().to_string(), n.preset.name),
            other => panic!("{text}: {other:?}"),
        };
        assert_eq!(CueSource::parse("a/masks", Gives::Masks), Ok(CueSource::File("a/masks".into())));
        assert_eq!(network("onnx:m/a.onnx:isnet", Gives::Masks), ("m/a.onnx".into(), "isnet"));
        assert_eq!(network("onnx:C:/isnet-general.onnx", Gives::Masks), ("C:/isnet-general.onnx".into(), "isnet"));
        assert_eq!(network("onnx:any.onnx", Gives::Masks), ("any.onnx".into(), "u2net"));
        assert_eq!(
            network("onnx:depth_anything_v2.onnx", Gives::Depth),
            ("depth_anything_v2.onnx".into(), "depth-anything")
        );
        let told = CueSource::parse("onnx:a.onnx:u2net", Gives::Depth).expect_err("masks are no depth");
        assert_eq!(told, "no preset for depth is called \"u2net\": there are midas, depth-anything");
        assert!(CueSource::parse("onnx:", Gives::Masks).expect_err("no file").contains("name the file"));
        let moved = CueSource::parse("onnx:a.onnx:isnet", Gives::Masks).expect("parses").at("b/a.onnx".into());
        assert_eq!(moved.path(), Path::new("b/a.onnx"));
    }
}

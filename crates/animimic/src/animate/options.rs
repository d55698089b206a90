//! What `animate` is asked to do.

use crate::camera::CameraChoice;
use crate::cues::CueSource;
use crate::rigging::RigChoice;
use crate::{Error, Physics};
use animimic_fit::Preset;
use animimic_scene::DepthKind;
use animimic_sim::tet::DEFAULT_TETS;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A model, its videos and how to treat them.
#[derive(Clone, Debug)]
pub struct Job {
    /// The model file or folder.
    pub model: PathBuf,
    /// One clip per video.
    pub videos: Vec<PathBuf>,
    /// Folder for the results; made if absent.
    pub out: PathBuf,
    /// Where the rig comes from.
    pub rig: RigChoice,
    /// The camera of the videos.
    pub camera: CameraChoice,
    /// Clip names, in the order of the videos; missing ones are taken from the file names.
    pub clips: Vec<String>,
    /// Only these frames of each video, after resampling.
    pub frames: Option<Range<usize>>,
    /// Working height of the video [px].
    pub height_px: usize,
    /// Masks made elsewhere (npz or folder of PNGs) or by a network, in the order of the videos; missing ones are found.
    pub masks: Vec<CueSource>,
    /// Point tracks made elsewhere (npz), in the order of the videos.
    pub tracks: Vec<PathBuf>,
    /// Depth made elsewhere (npz, or folder of 16-bit PNGs or EXRs) or by a network, in the order of the videos.
    pub depth: Vec<CueSource>,
    /// What that depth means, where its files do not say so.
    pub depth_kind: Option<DepthKind>,
    /// How the motion is found.
    pub preset: Preset,
    /// How far to go.
    pub stage: Stage,
    /// How soft tissue is made.
    pub flesh: Flesh,
    /// How motion that goes beyond the skeleton is delivered.
    pub physics: Physics,
    /// Mend what is broken in small ways (indices and joints out of range, values that are not finite) instead of refusing.
    pub repair: bool,
    /// Seed of everything random.
    pub seed: u64,
    /// Whether what an earlier run kept in `out` is taken where it fits.
    pub resume: bool,
}

/// How far `animate` goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stage {
    /// The skeleton's motion alone.
    Pose,
    /// And soft tissue on it.
    #[default]
    Soft,
}

impl Stage {
    /// All stages, in order.
    pub const ALL: [Stage; 2] = [Stage::Pose, Stage::Soft];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Pose => "pose",
            Stage::Soft => "soft",
        }
    }
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Stage {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|s| s.name() == text);
        found.ok_or_else(|| format!("no stage named {text}: there are pose and soft"))
    }
}

/// How soft tissue is made where its material is learnt.
#[derive(Clone, Debug)]
pub struct Flesh {
    /// About how many tets.
    pub tets: usize,
    /// Length of the rest diagonal [m].
    pub size_m: f64,
    /// Young's modulus that flesh is taken to have before the video speaks [Pa].
    pub young: f64,
    /// Names of joints that do not hold what hangs on them, beside those that the video shows to be loose.
    pub loose: Vec<String>,
}

impl Default for Flesh {
    /// 3 000 tets, 1 m, flesh.
    fn default() -> Self {
        Self { tets: DEFAULT_TETS, size_m: 1.0, young: crate::soften::PRESETS[0].1, loose: Vec::new() }
    }
}

/// Lowest and highest working height [px].
const HEIGHTS_PX: std::ops::RangeInclusive<usize> = 64..=2160;

impl Job {
    /// A job with the defaults.
    pub fn new(model: impl Into<PathBuf>, videos: Vec<PathBuf>, out: impl Into<PathBuf>) -> Self {
        Self {
            model: model.into(),
            videos,
            out: out.into(),
            rig: RigChoice::Auto,
            camera: CameraChoice::Auto,
            clips: Vec::new(),
            frames: None,
            height_px: 512,
            masks: Vec::new(),
            tracks: Vec::new(),
            depth: Vec::new(),
            depth_kind: None,
            preset: Preset::Default,
            stage: Stage::default(),
            flesh: Flesh::default(),
            physics: Physics::default(),
            repair: false,
            seed: 0,
            resume: false,
        }
    }

    /// All options in words, but for where files lie and whether the run is resumed.
    pub(super) fn words(&self) -> String {
        let name = |p: &PathBuf| p.file_name().map(PathBuf::from).unwrap_or_default();
        let names = |paths: &[PathBuf]| paths.iter().map(name).collect();
        let sources = |list: &[CueSource]| list.iter().map(|s| s.at(name(&s.path().into()))).collect();
        let plain = Self {
            model: name(&self.model),
            videos: names(&self.videos),
            masks: sources(&self.masks),
            tracks: names(&self.tracks),
            depth: sources(&self.depth),
            out: PathBuf::new(),
            resume: false,
            ..self.clone()
        };
        format!("{plain:?}")
    }

    /// Refuses what cannot make sense before any file is read.
    pub(super) fn check(&self) -> Result<(), Error> {
        if self.videos.is_empty() {
            return Err(Error::Input("no video given: name at least one".into()));
        }
        if self.clips.len() > self.videos.len() {
            return Err(Error::Input(format!("{} clip names for {} videos", self.clips.len(), self.videos.len())));
        }
        for (what, count) in [("masks", self.masks.len()), ("tracks", self.tracks.len()), ("depths", self.depth.len())]
        {
            if count > self.videos.len() {
                return Err(Error::Input(format!("{count} {what} for {} videos", self.videos.len())));
            }
        }
        if !HEIGHTS_PX.contains(&self.height_px) {
            return Err(Error::Input(format!("working height {} px: use 64 to 2160", self.height_px)));
        }
        Ok(())
    }

    /// One name per video, unique: given ones first, then file names, numbered where they collide.
    pub(super) fn clip_names(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for (k, video) in self.videos.iter().enumerate() {
            let wanted = self.clips.get(k).cloned().unwrap_or_else(|| stem(video));
            let mut name = wanted.clone();
            let mut number = 2;
            while names.contains(&name) {
                name = format!("{wanted}_{number}");
                number += 1;
            }
            names.push(name);
        }
        names
    }
}

fn stem(path: &Path) -> String {
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    if stem.is_empty() { "clip".into() } else { stem }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clips_are_named_after_their_videos_and_never_twice_the_same() {
        let mut job = Job::new("m.glb", vec!["a/walk.mp4".into(), "b/walk.mp4".into(), "run.gif".into()], "out");
        assert_eq!(job.clip_names(), ["walk", "walk_2", "run"]);
        job.clips = vec!["run".into()];
        assert_eq!(job.clip_names(), ["run", "walk", "run_2"]);
        job.height_px = 3;
        assert!(job.check().unwrap_err().to_string().contains("64 to 2160"));
    }
}

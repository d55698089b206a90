//! What `animate` is asked to do.

use crate::camera::CameraChoice;
use crate::rigging::RigChoice;
use crate::{Error, Physics};
use animimic_fit::Preset;
use animimic_scene::DepthKind;
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
    /// Masks made elsewhere (npz or folder of PNGs), in the order of the videos; missing ones are found.
    pub masks: Vec<PathBuf>,
    /// Point tracks made elsewhere (npz), in the order of the videos.
    pub tracks: Vec<PathBuf>,
    /// Depth made elsewhere (npz or folder of 16-bit PNGs), in the order of the videos.
    pub depth: Vec<PathBuf>,
    /// What that depth means, where its files do not say so.
    pub depth_kind: Option<DepthKind>,
    /// How the motion is found.
    pub preset: Preset,
    /// How motion that goes beyond the skeleton is delivered.
    pub physics: Physics,
    /// Mend what is broken in small ways (indices and joints out of range, values that are not finite) instead of refusing.
    pub repair: bool,
    /// Seed of everything random.
    pub seed: u64,
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
            physics: Physics::default(),
            repair: false,
            seed: 0,
        }
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

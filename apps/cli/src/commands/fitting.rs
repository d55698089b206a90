//! What `animate` and `fit` have in common.

use super::shared::Mend;
use crate::bar::Bar;
use crate::{Common, out};
use animimic::camera::CameraChoice;
use animimic::cues::{CueSource, Gives};
use animimic::rigging::RigChoice;
use animimic::scene::DepthKind;
use animimic::{Error, Job, Preset, Progress, Report};
use clap::ValueHint;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Options that shape the motion that is found.
#[derive(clap::Args)]
pub struct Fitting {
    /// The rig: auto (the model's own, else one is made), keep (only the model's own), or a rigged GLB or rig.txt
    #[arg(long, value_name = "auto|keep|FILE", default_value = "auto", value_hint = ValueHint::AnyPath)]
    pub rig: RigChoice,
    /// Camera of the videos: auto, a camera.json or the still, or preset:NAME (see `animimic list cameras`)
    #[arg(long, value_name = "auto|FILE|preset:NAME", default_value = "auto", value_hint = ValueHint::AnyPath)]
    pub camera: CameraChoice,
    /// Name of the clip in the GLB; once per video [default: the video's file name]
    #[arg(long = "clip", value_name = "NAME")]
    pub clips: Vec<String>,
    /// Use only frames A up to, not including, B of each video
    #[arg(long, value_name = "A..B", value_parser = range)]
    pub frames: Option<Range<usize>>,
    /// Masks made elsewhere (npz or folder of PNGs), or by a network (u2net, isnet), instead of found ones; once per video
    #[arg(long = "mask", value_name = "FILE|DIR|onnx:FILE[:PRESET]", value_parser = masks, value_hint = ValueHint::AnyPath)]
    pub masks: Vec<CueSource>,
    /// Point tracks made elsewhere (npz: tracks, visibility, queries; pixels of the video's own size); once per video
    #[arg(long = "tracks", value_name = "FILE")]
    pub tracks: Vec<PathBuf>,
    /// Depth made elsewhere (npz, or folder of 16-bit PNGs or EXRs), or by a network (midas, depth-anything), up to scale and shift per frame; once per video
    #[arg(long = "depth", value_name = "FILE|DIR|onnx:FILE[:PRESET]", value_parser = depth, value_hint = ValueHint::AnyPath)]
    pub depth: Vec<CueSource>,
    /// What the depth means: metric (distance) or inverse (disparity) [default: what the npz says, inverse of a network, else metric]
    #[arg(long, value_name = "metric|inverse", value_parser = depth_kind)]
    pub depth_kind: Option<DepthKind>,
    /// Height at which the video is worked on [px]; never enlarged
    #[arg(long, value_name = "PX", default_value_t = 512)]
    pub height: usize,
    #[command(flatten)]
    pub mend: Mend,
    /// How the motion is found (see `animimic list presets`)
    #[arg(long, value_name = "NAME", default_value_t = Preset::Default)]
    pub preset: Preset,
}

impl Fitting {
    /// Does `work` with a bar, and prints its report with what was made: the path that `made` finds in the result's.
    pub fn run(
        &self,
        job: &Job,
        common: &Common,
        work: impl FnOnce(&Job, &mut Progress) -> Result<Report, Error>,
        made: impl FnOnce(&Path) -> PathBuf,
    ) -> anyhow::Result<()> {
        let mut bar = Bar::new(common);
        let report = work(job, &mut |e| bar.on_event(e))?;
        drop(bar);
        let json = serde_json::to_value(&report)?;
        out::print(common, &json, || words(&report) + &format!("{}\n", made(&job.out).display()))
    }

    /// The job that the options ask for.
    pub fn job(&self, model: &Path, videos: Vec<PathBuf>, out: &Path, common: &Common) -> Job {
        Job {
            rig: self.rig.clone(),
            camera: self.camera.clone(),
            clips: self.clips.clone(),
            frames: self.frames.clone(),
            height_px: self.height,
            masks: self.masks.clone(),
            tracks: self.tracks.clone(),
            depth: self.depth.clone(),
            depth_kind: self.depth_kind,
            preset: self.preset,
            repair: self.mend.repair,
            seed: common.seed,
            ..Job::new(model, videos, out)
        }
    }
}

/// A report in a few lines for people.
fn words(report: &Report) -> String {
    let mut text = format!("rig: {}\n", report.rig);
    for clip in &report.clips {
        let number = |key: &str| clip.metrics.get(key).and_then(|v| v.as_f64());
        text += &format!("{}: {} frames", clip.name, clip.frames);
        for (key, words) in [("iou_main", "mask IoU"), ("ssim", "SSIM"), ("psnr_box_db", "PSNR of the object")] {
            if let Some(v) = number(key) {
                text += &format!(", {words} {v:.3}");
            }
        }
        text += "\n";
        if let Some(verdict) = clip.softness["verdict"].as_str() {
            text += &format!("  {verdict}\n");
        }
        clip.uncertain.iter().for_each(|doubt| text += &format!("  uncertain: {doubt}\n"));
    }
    text
}

/// Where masks come from.
pub(super) fn masks(text: &str) -> Result<CueSource, String> {
    CueSource::parse(text, Gives::Masks)
}

/// Where depth comes from.
pub(super) fn depth(text: &str) -> Result<CueSource, String> {
    CueSource::parse(text, Gives::Depth)
}

/// The word for what depth values mean.
pub(super) fn depth_kind(text: &str) -> Result<DepthKind, String> {
    match text {
        "metric" => Ok(DepthKind::Metric),
        "inverse" => Ok(DepthKind::Inverse),
        _ => Err("depth is metric or inverse".into()),
    }
}

/// `A..B`, `A..` or `..B`.
fn range(text: &str) -> Result<Range<usize>, String> {
    let (a, b) = text.split_once("..").ok_or("write A..B, for example 0..48")?;
    let number =
        |s: &str, default| if s.is_empty() { Ok(default) } else { s.parse::<usize>().map_err(|e| e.to_string()) };
    let (a, b) = (number(a, 0)?, number(b, usize::MAX)?);
    if b < a.saturating_add(2) { Err("at least two frames are needed".into()) } else { Ok(a..b) }
}

#[cfg(test)]
mod tests {
    use super::range;

    #[test]
    fn frame_ranges_may_be_open_and_must_hold_two_frames() {
        assert_eq!(range("3..9"), Ok(3..9));
        assert_eq!(range("..9"), Ok(0..9));
        assert_eq!(range("3.."), Ok(3..usize::MAX));
        assert!(range("3..4").is_err() && range("x..4").is_err() && range("7").is_err());
    }
}

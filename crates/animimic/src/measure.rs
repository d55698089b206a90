//! Evaluation from files: reads the asset, the video and the truth, samples the clip and measures.

use crate::camera::{self, CameraChoice};
use crate::event::{Event, Progress, tell};
use crate::{Against, Error, Evaluation, evaluate, truth};
use animimic_scene::io::{self, gltf};
use animimic_scene::{Asset, Camera, Pose, Video};
use animimic_video::cues;
use std::path::PathBuf;

/// What to measure against what.
#[derive(Clone, Debug)]
pub struct Measure {
    /// The animated model.
    pub asset: PathBuf,
    /// The video that it should look like.
    pub video: Option<PathBuf>,
    /// A folder of truth, see [`crate::truth`].
    pub truth: Option<PathBuf>,
    /// The model before it was animated.
    pub input: Option<PathBuf>,
    /// Camera of the video; the truth's where absent.
    pub camera: Option<CameraChoice>,
    /// Clip name; the first where absent.
    pub clip: Option<String>,
    /// Height at which the video is compared [px].
    pub height_px: usize,
}

/// Measures files. With truth, frame t of the truth is compared with the clip at t / fps; without, the video's frames are.
///
/// # Errors
/// Unreadable files; no clip (of that name); neither video nor truth; no camera for the video.
pub fn evaluate_files(measure: &Measure, progress: &mut Progress) -> Result<Evaluation, Error> {
    tell(progress, Event::Stage { name: "reading" })?;
    if measure.video.is_none() && measure.truth.is_none() {
        return Err(Error::Input("nothing to measure against: give a video or --truth DIR".into()));
    }
    let asset = io::read(&measure.asset)?;
    let clip = clip(&asset, &measure.asset, measure.clip.as_deref())?;
    let truth = measure.truth.as_deref().map(truth::read).transpose()?;
    let input = measure.input.as_ref().map(io::read).transpose()?;
    let video = match &measure.video {
        Some(path) => {
            let options = animimic_video::ReadOptions { working_height: Some(measure.height_px), ..Default::default() };
            Some(animimic_video::read(path, &options)?)
        }
        None => None,
    };
    let (count, fps) = match (&truth, &video) {
        (Some(t), _) => (t.vertices.len(), t.camera.as_ref().map_or(clip_rate(&video), |c| c.fps)),
        (None, Some(v)) => (v.frames.len(), v.fps),
        (None, None) => (0, 1.0),
    };
    let poses: Vec<Pose> = (0..count).map(|t| clip.pose(&asset.rig.skeleton, t as f64 / fps)).collect();
    tell(progress, Event::Stage { name: "measuring" })?;
    let mask_cue = video.as_ref().map(|v| cues::masks(v, &cues::MaskOptions::default()));
    let against = Against {
        truth: truth.as_ref(),
        input: input.as_ref(),
        camera: video.as_ref().map(|v| camera_of(measure, &asset, v, truth.as_ref())).transpose()?,
        video: video.as_ref().map_or(&[], |v| &v.frames),
        masks: mask_cue.as_ref().map_or(&[], |m| &m.masks),
        background: mask_cue.as_ref().map(|m| &m.background),
    };
    evaluate(&asset, &poses, fps, &against)
}

fn clip_rate(video: &Option<Video>) -> f64 {
    /// Where neither a camera file nor a video says the truth's rate: the rate of the test data.
    const DEFAULT_FPS: f64 = 24.0;
    video.as_ref().map_or(DEFAULT_FPS, |v| v.fps)
}

/// The clip of that name, or the first.
pub(crate) fn clip(asset: &Asset, path: &std::path::Path, name: Option<&str>) -> Result<gltf::Clip, Error> {
    let clips = gltf::clips(asset)?;
    let names: Vec<String> = clips.iter().map(|c| c.name.clone()).collect();
    let found = clips.into_iter().find(|c| name.is_none_or(|n| n == c.name));
    found.ok_or_else(|| {
        let path = path.display();
        Error::Input(match name {
            Some(n) if !names.is_empty() => format!("{path}: has no clip named {n}, but {}", names.join(", ")),
            _ => format!("{path}: has no animation to play"),
        })
    })
}

fn camera_of(measure: &Measure, asset: &Asset, video: &Video, truth: Option<&truth::Truth>) -> Result<Camera, Error> {
    let (width, height) = (video.frames[0].width as u32, video.frames[0].height as u32);
    match (&measure.camera, truth.and_then(|t| t.camera.as_ref())) {
        (Some(CameraChoice::File(path)), _) => Ok(camera::from_file(path, width, height)?.main),
        (Some(CameraChoice::Preset(name)), _) => camera::preset(name, asset.mesh.bounds(), width, height),
        (None, Some(file)) => Ok(file.main.resized(width, height)),
        _ => Err(Error::Input("the video's camera is not known: give --camera FILE or preset:NAME".into())),
    }
}

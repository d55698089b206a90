//! Videos and pictures of an asset from chosen views, with overlays.

pub mod overlays;
mod view;

pub use view::View;

use crate::camera::CameraChoice;
use crate::event::{Event, Progress, tell};
use crate::film::{Encode, film_as};
use crate::measure::clip;
use crate::pictures::{Studio, background_picture};
use crate::{Error, cues};
use animimic_render::{Light, overlay};
use animimic_scene::io::{self, gltf};
use animimic_scene::{Asset, Image, Video};
use animimic_video::cues::providers::Found;
use animimic_video::{VideoError, encode_gif, encode_mp4, encode_png};
use glam::DVec3;
use overlays::{Observed, Overlay, Seen};
use std::path::{Path, PathBuf};
use view::Cameras;

/// What to draw, from where, into which file.
#[derive(Clone, Debug)]
pub struct Shoot {
    /// The model.
    pub asset: PathBuf,
    /// `.mp4`, `.gif` or `.png`.
    pub out: PathBuf,
    /// Views, left to right.
    pub views: Vec<View>,
    /// Camera of [`View::Input`].
    pub camera: CameraChoice,
    /// Clip to play; the first where absent.
    pub clip: Option<String>,
    /// Names of [`overlays`].
    pub overlays: Vec<String>,
    /// The video that residuals are measured against; its rate and length count, and its height where it is lower.
    pub video: Option<PathBuf>,
    /// The moment that a `.png` shows [s].
    pub at_secs: f64,
    /// Height of each view [px].
    pub height_px: usize,
    /// Frames per second.
    pub fps: f64,
    /// Mend what is broken in small ways (indices and joints out of range, values that are not finite) instead of refusing.
    pub repair: bool,
}

const BACKGROUND: [u8; 3] = [226, 228, 230];
/// Length of a still model's turntable [s].
const TURN_SECS: f64 = 4.0;

/// The kinds of files that are written; a picture is a video's only frame.
const FILES: &[(&str, Encode)] = &[("mp4", encode_mp4), ("gif", encode_gif), ("png", encode_first)];

fn encode_first(frames: &mut dyn Iterator<Item = Image>, _fps: f64) -> Result<Vec<u8>, VideoError> {
    // A stop comes before the frame: its error is told, not this one.
    encode_png(&frames.next().ok_or(VideoError::Stopped)?)
}

/// Draws the views side by side and writes the file; returns the number of frames.
///
/// # Errors
/// Unreadable model or video, unknown clip, camera or overlay, an overlay that the model has no data for, residuals without a video, another kind of file, or a stop.
pub fn render(shoot: &Shoot, progress: &mut Progress) -> Result<usize, Error> {
    let extension = shoot.out.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let (kind, encode) = FILES
        .iter()
        .find(|f| f.0 == extension)
        .ok_or_else(|| Error::Input(format!("{}: name a .mp4, .gif or .png file", shoot.out.display())))?;
    let sound = (16..=4096).contains(&shoot.height_px) && shoot.fps > 0.0 && shoot.fps <= 240.0;
    if !sound || shoot.views.is_empty() || !(0.0..=1e6).contains(&shoot.at_secs) {
        return Err(Error::Input("views need a height of 16 to 4096 px and 1 to 240 frames per second".into()));
    }
    let overlays = overlays::find(&shoot.overlays)?;
    if overlays.iter().any(|o| o.compares()) && (shoot.video.is_none() || !shoot.views.contains(&View::Input)) {
        return Err(Error::Input("residuals need --video FILE and the view input, that of the video's camera".into()));
    }
    let stage = Stage::new(shoot, overlays, progress)?;
    let frames = if *kind == "png" { 1 } else { stage.frames };
    tell(progress, Event::Stage { name: "drawing" })?;
    let first = if *kind == "png" { (shoot.at_secs * stage.fps).round() as usize } else { 0 };
    let draw = |t: usize| stage.frame(first + t);
    film_as(*encode, &shoot.out, (frames, stage.fps), (0.0, 1.0), draw, progress)?;
    Ok(frames)
}

/// Everything that frames are drawn from.
struct Stage {
    asset: Asset,
    play: Option<gltf::Clip>,
    studio: Studio,
    cameras: Cameras,
    overlays: Vec<&'static dyn Overlay>,
    observed: Option<(Video, Found)>,
    frames: usize,
    fps: f64,
}

impl Stage {
    fn new(shoot: &Shoot, overlays: Vec<&'static dyn Overlay>, progress: &mut Progress) -> Result<Self, Error> {
        tell(progress, Event::Stage { name: "reading" })?;
        let asset = io::read_with(&shoot.asset, &io::ReadOptions { repair: shoot.repair })?;
        for warning in &asset.warnings {
            tell(progress, Event::Warning(warning.clone()))?;
        }
        if let Some(what) = overlays.iter().find_map(|o| o.lacks(&asset)) {
            return Err(Error::Input(format!("{}: {what}", shoot.asset.display())));
        }
        let play = player(&asset, shoot)?;
        let observed = shoot.video.as_deref().map(|v| observed(v, shoot.height_px)).transpose()?;
        let fps = observed.as_ref().map_or(shoot.fps, |(video, _)| video.fps);
        let frames = match (&observed, &play) {
            (Some((video, _)), _) => video.frames.len(),
            (None, Some(clip)) => (clip.duration * fps).round() as usize + 1,
            (None, None) => (TURN_SECS * fps).round() as usize,
        };
        let size = observed.as_ref().map(|(video, _)| (video.frames[0].width as u32, video.frames[0].height as u32));
        let height = size.map_or(shoot.height_px as u32, |s| s.1);
        let cameras = Cameras::new(shoot, &asset, size.map(|s| s.0), height)?;
        let studio = match (overlays.iter().find_map(|o| o.repainted(&asset)), &observed) {
            (Some(repainted), _) => Studio::with_light(&repainted, Light::default())?,
            (None, Some((video, found))) => {
                let rest = posed(&asset, &play, 0.0).0;
                Studio::new(&asset, &cameras.main, &rest, &video.frames[0], found.cues.masks.first())?
            }
            (None, None) => Studio::with_light(&asset, Light::default())?,
        };
        Ok(Self { asset, play, studio, cameras, overlays, observed, frames, fps })
    }

    /// All views of frame `t`, side by side.
    fn frame(&self, t: usize) -> Image {
        let (positions, joints) = posed(&self.asset, &self.play, t as f64 / self.fps);
        let height = self.cameras.main.height as usize;
        let mut out = Image::filled(self.cameras.width(), height, BACKGROUND);
        let mut left = 0;
        for (view, camera) in self.cameras.at(t as f64 / self.frames as f64) {
            let now = self.observed.as_ref().filter(|(video, _)| *view == View::Input && t < video.frames.len());
            let (mut picture, coverage) = match now {
                Some((video, found)) => {
                    let behind = background_picture(&found.background, &video.frames[t], t);
                    self.studio.draw_over(&camera, &positions, &behind)
                }
                None => self.studio.draw(&camera, &positions, BACKGROUND),
            };
            let observed = now.map(|(video, f)| Observed { frame: &video.frames[t], mask: &f.cues.masks[t] });
            let seen = Seen { asset: &self.asset, joints: &joints, camera: &camera, coverage: &coverage, observed };
            self.overlays.iter().for_each(|o| o.paint(&mut picture, &seen));
            overlay::paste(&mut out, &picture, left, 0);
            left += camera.width as usize;
        }
        out
    }
}

/// The video and where the object is in it.
fn observed(path: &Path, height_px: usize) -> Result<(Video, Found), Error> {
    let options = animimic_video::ReadOptions { working_height: Some(height_px), ..Default::default() };
    let video = animimic_video::read(path, &options)?;
    let found = cues::find(&video, &cues::Given::default())?;
    Ok((video, found))
}

/// Surface and joints at a moment of the clip, or at rest.
fn posed(asset: &Asset, play: &Option<gltf::Clip>, secs: f64) -> (Vec<DVec3>, Vec<DVec3>) {
    let skeleton = &asset.rig.skeleton;
    let origins = |world: &[glam::DAffine3]| world.iter().map(|w| w.translation).collect();
    match play {
        Some(clip) => {
            let world = skeleton.world_from_joint(&clip.pose(skeleton, secs).locals);
            (asset.rig.skinned(&world), origins(&world))
        }
        None => (asset.mesh.positions.clone(), origins(&skeleton.rest_world())),
    }
}

fn player(asset: &Asset, shoot: &Shoot) -> Result<Option<gltf::Clip>, Error> {
    if shoot.clip.is_none() && gltf::clips(asset)?.is_empty() {
        return Ok(None);
    }
    clip(asset, &shoot.asset, shoot.clip.as_deref()).map(Some)
}

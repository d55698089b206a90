//! Videos and pictures of an asset from chosen views.

use crate::Error;
use crate::camera::{self, CameraChoice};
use crate::event::{Event, Progress, tell};
use crate::film::film;
use crate::measure::clip;
use crate::pictures::Studio;
use animimic_render::{Light, overlay};
use animimic_scene::io::{self, gltf};
use animimic_scene::{Asset, Camera, Image};
use glam::DVec3;
use std::path::PathBuf;

/// A view to draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum View {
    /// The given camera.
    Input,
    /// The given camera turned about the vertical through the model [degrees].
    Turned(f64),
    /// The camera going once around the model.
    Turntable,
}

impl std::str::FromStr for View {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "input" => Ok(Self::Input),
            "turntable" => Ok(Self::Turntable),
            angle => match angle.parse::<f64>() {
                Ok(deg) if deg.is_finite() => Ok(Self::Turned(deg)),
                _ => Err("a view is input, turntable or an angle in degrees such as +45".into()),
            },
        }
    }
}

/// What to draw, from where, into which file.
#[derive(Clone, Debug)]
pub struct Shoot {
    /// The model.
    pub asset: PathBuf,
    /// `.mp4` or `.png`.
    pub out: PathBuf,
    /// Views, left to right.
    pub views: Vec<View>,
    /// Camera of [`View::Input`].
    pub camera: CameraChoice,
    /// Clip to play; the first where absent.
    pub clip: Option<String>,
    /// Height of each view [px].
    pub height_px: usize,
    /// Frames per second.
    pub fps: f64,
}

const BACKGROUND: [u8; 3] = [226, 228, 230];
/// Length of a still model's turntable [s].
const TURN_SECS: f64 = 4.0;

/// Draws the views side by side and writes the file; returns the number of frames.
///
/// # Errors
/// Unreadable model, unknown clip or camera, an output that is neither `.mp4` nor `.png`, or a stop.
pub fn render(shoot: &Shoot, progress: &mut Progress) -> Result<usize, Error> {
    let moving = match shoot.out.extension().and_then(|e| e.to_str()) {
        Some("mp4") => true,
        Some("png") => false,
        _ => return Err(Error::Input(format!("{}: name a .mp4 or .png file", shoot.out.display()))),
    };
    let sound = (16..=4096).contains(&shoot.height_px) && shoot.fps > 0.0 && shoot.fps <= 240.0;
    if !sound || shoot.views.is_empty() {
        return Err(Error::Input("views need a height of 16 to 4096 px and 1 to 240 frames per second".into()));
    }
    tell(progress, Event::Stage { name: "reading" })?;
    let asset = io::read(&shoot.asset)?;
    let play = player(&asset, shoot)?;
    let frames = match (&play, moving) {
        (_, false) => 1,
        (Some(c), true) => (c.duration * shoot.fps).round() as usize + 1,
        (None, true) => (TURN_SECS * shoot.fps).round() as usize,
    };
    let (low, high) = asset.mesh.bounds();
    let (main, target) = main_camera(shoot, (low, high))?;
    let studio = Studio::with_light(&asset, Light::default())?;
    tell(progress, Event::Stage { name: "drawing" })?;
    let draw = |t: usize| frame(shoot, &asset, &play, &studio, &main, target, t, frames);
    if !moving {
        animimic_video::write_png(&shoot.out, &draw(0))?;
        return Ok(1);
    }
    film(&shoot.out, (frames, shoot.fps), (0.0, 1.0), draw, progress)?;
    Ok(frames)
}

fn player(asset: &Asset, shoot: &Shoot) -> Result<Option<gltf::Clip>, Error> {
    if shoot.clip.is_none() && gltf::clips(asset)?.is_empty() {
        return Ok(None);
    }
    clip(asset, &shoot.asset, shoot.clip.as_deref()).map(Some)
}

fn main_camera(shoot: &Shoot, bounds: (DVec3, DVec3)) -> Result<(Camera, DVec3), Error> {
    let center = 0.5 * (bounds.0 + bounds.1);
    let height = shoot.height_px as u32;
    match &shoot.camera {
        CameraChoice::Preset(name) => Ok((camera::preset(name, bounds, height, height)?, center)),
        CameraChoice::File(path) => {
            let file = io::camera_json::read(path)?;
            let width = (f64::from(file.main.width) * f64::from(height) / f64::from(file.main.height)).round() as u32;
            Ok((file.main.resized(width.max(1), height), file.target.unwrap_or(center)))
        }
        CameraChoice::Auto => Err(Error::Input("drawing needs a camera: a camera.json or preset:NAME".into())),
    }
}

fn frame(
    shoot: &Shoot,
    asset: &Asset,
    play: &Option<gltf::Clip>,
    studio: &Studio,
    main: &Camera,
    target: DVec3,
    t: usize,
    frames: usize,
) -> Image {
    let skeleton = &asset.rig.skeleton;
    let positions = match play {
        Some(clip) => asset.rig.skinned(&skeleton.world_from_joint(&clip.pose(skeleton, t as f64 / shoot.fps).locals)),
        None => asset.mesh.positions.clone(),
    };
    let (width, height) = (main.width as usize, main.height as usize);
    let mut out = Image::filled(width * shoot.views.len(), height, BACKGROUND);
    for (k, view) in shoot.views.iter().enumerate() {
        let turn = match view {
            View::Input => 0.0,
            View::Turned(deg) => deg.to_radians(),
            View::Turntable => std::f64::consts::TAU * t as f64 / frames as f64,
        };
        let (picture, _) = studio.draw(&main.orbited(target, turn), &positions, BACKGROUND);
        overlay::paste(&mut out, &picture, k * width, 0);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_named_or_angles() {
        assert_eq!("input".parse(), Ok(View::Input));
        assert_eq!("-45".parse(), Ok(View::Turned(-45.0)));
        assert_eq!("+45".parse(), Ok(View::Turned(45.0)));
        assert!("left".parse::<View>().is_err());
    }
}

//! Which camera looks at the model: a file, a preset, or found from the first frame.

use crate::Error;
use crate::cues::dense_flow;
use crate::pictures::background_picture;
use animimic_fit::camera::{CameraFit, CameraSearch, find_camera};
use animimic_scene::{Asset, Camera, CameraFile, Image, Mask, io};
use animimic_video::cues::Background;
use glam::{DVec2, DVec3};
use std::path::PathBuf;

/// How the camera is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum CameraChoice {
    /// Searched so that the rest model fits frame 0.
    #[default]
    Auto,
    /// Read from a `camera.json`, or from inside a still.
    File(PathBuf),
    /// A named camera, see [`PRESETS`].
    Preset(String),
}

impl std::fmt::Display for CameraChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Auto => write!(f, "auto"),
            // The folder is left out, so that reports do not depend on where the files lie.
            Self::File(path) => write!(f, "{}", path.file_name().unwrap_or_default().to_string_lossy()),
            Self::Preset(name) => write!(f, "preset:{name}"),
        }
    }
}

impl std::str::FromStr for CameraChoice {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text.strip_prefix("preset:") {
            _ if text == "auto" => Self::Auto,
            Some(name) => Self::Preset(name.to_owned()),
            None => Self::File(text.into()),
        })
    }
}

/// A named camera: where it stands relative to the centred bounding box.
pub struct Preset {
    /// Name after `preset:`.
    pub name: &'static str,
    /// One line of explanation.
    pub summary: &'static str,
    /// Length of the box that counts as 1: half the longest side, or the whole.
    unit_per_longest: f64,
    distance: f64,
    azimuth_deg: f64,
    elevation_deg: f64,
    fov_y_rad: f64,
}

/// Vertical field of view of Puppeteer's renderer [rad].
const PUPPETEER_FOV_RAD: f64 = 0.691_111_2;

const fn puppeteer(name: &'static str, azimuth_deg: f64, summary: &'static str) -> Preset {
    let (distance, elevation_deg, fov_y_rad) = (2.0, 0.0, PUPPETEER_FOV_RAD);
    Preset { name, summary, unit_per_longest: 1.0, distance, azimuth_deg, elevation_deg, fov_y_rad }
}

/// All presets.
pub const PRESETS: &[Preset] = &[
    Preset {
        name: "reference",
        summary: "half the longest side is 1, field of view 60°, distance 2.7, elevation 10°, azimuth 45°",
        unit_per_longest: 0.5,
        distance: 2.7,
        azimuth_deg: 45.0,
        elevation_deg: 10.0,
        fov_y_rad: std::f64::consts::FRAC_PI_3,
    },
    puppeteer("puppeteer", 0.0, "longest side is 1, field of view 39.6°, distance 2, level, from the front (+Z)"),
    puppeteer("puppeteer:front", 0.0, "the same as puppeteer"),
    puppeteer("puppeteer:front_right", 45.0, "puppeteer's camera between +Z and +X"),
    puppeteer("puppeteer:right", 90.0, "puppeteer's camera on +X"),
    puppeteer("puppeteer:back_right", 135.0, "puppeteer's camera between +X and -Z"),
    puppeteer("puppeteer:back", 180.0, "puppeteer's camera on -Z"),
    puppeteer("puppeteer:back_left", 225.0, "puppeteer's camera between -Z and -X"),
    puppeteer("puppeteer:left", 270.0, "puppeteer's camera on -X"),
    puppeteer("puppeteer:front_left", 315.0, "puppeteer's camera between -X and +Z"),
];

/// The preset's camera for a model that stands in the box `low..high`, for pictures of `width` × `height`.
///
/// # Errors
/// [`Error::Input`] with the known names.
pub fn preset(name: &str, (low, high): (DVec3, DVec3), width: u32, height: u32) -> Result<Camera, Error> {
    let p = PRESETS.iter().find(|p| p.name == name).ok_or_else(|| {
        let known: Vec<&str> = PRESETS.iter().map(|p| p.name).collect();
        Error::Input(format!("no camera preset named {name}: use one of {}", known.join(", ")))
    })?;
    let unit = (high - low).max_element() * p.unit_per_longest;
    let (azimuth, elevation) = (p.azimuth_deg.to_radians(), p.elevation_deg.to_radians());
    Ok(Camera::orbit(0.5 * (low + high), p.distance * unit, azimuth, elevation, p.fov_y_rad, width, height))
}

/// Reads a camera file, or the camera inside a still.
///
/// # Errors
/// [`Error::Scene`] for a broken file, [`Error::Input`] for a picture without a camera.
pub fn read(path: &std::path::Path) -> Result<CameraFile, Error> {
    let is_still = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
    if is_still { crate::still::camera_inside(path) } else { Ok(io::camera_json::read(path)?) }
}

/// Reads a camera file, or the camera inside a still, and fits it to pictures of `width` × `height`.
///
/// # Errors
/// [`Error::Scene`] for a broken file, [`Error::Input`] when the pictures have another shape.
pub fn from_file(path: &std::path::Path, width: u32, height: u32) -> Result<CameraFile, Error> {
    /// Shapes that differ by less are rounding of the working size.
    const SAME_SHAPE: f64 = 0.01;
    let mut file = read(path)?;
    let (own, wanted) =
        (f64::from(file.main.width) / f64::from(file.main.height), f64::from(width) / f64::from(height));
    if (own / wanted - 1.0).abs() > SAME_SHAPE {
        return Err(Error::Input(format!(
            "{}: made for {}×{} pictures, and {width}×{height} has another shape: crop or pad the video, or ask for the camera's own size",
            path.display(),
            file.main.width,
            file.main.height
        )));
    }
    file.main = file.main.resized(width, height);
    file.views.iter_mut().for_each(|(_, c)| *c = c.resized(width, height));
    Ok(file)
}

/// Searches the camera that shows the rest model as in a video's first frame.
///
/// # Errors
/// [`Error::Fit`] when the mask is empty or no camera explains it; the message says what to do.
pub fn find(asset: &Asset, frame: &Image, mask: &Mask, background: &Background) -> Result<CameraFit, Error> {
    let behind = background_picture(background, frame, 0);
    Ok(find_camera(&CameraSearch { asset, frame, mask, background: &behind, flow: &dense_flow })?)
}

/// Views to look at a result from: the input view turned by ±45° about the vertical through `target`.
pub fn side_views(main: &Camera, target: DVec3) -> [Camera; 2] {
    let turn = std::f64::consts::FRAC_PI_4;
    [main.orbited(target, -turn), main.orbited(target, turn)]
}

/// Room around what is kept in view [share of the picture].
const ROOM: f64 = 0.04;

/// The view moved, and drawn smaller, as far as it takes to see all `points`; the same where it sees them.
pub fn keep_in_view(camera: &Camera, points: &[DVec3]) -> Camera {
    let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
    let seen = points.iter().map(|&p| camera.to_view(p)).filter(|v| v.z > 0.0).map(|v| camera.pixel_from_view(v));
    let (low, high) = seen.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    if !(low.is_finite() && high.is_finite()) {
        return *camera;
    }
    let center = DVec2::new(camera.cx, camera.cy);
    let (first, last) = (ROOM * size, (1.0 - ROOM) * size);
    let scale = ((last - first) / (high - low).max(DVec2::splat(1e-9))).min_element().min(1.0);
    // The larger bound first: where all just fits, the two are equal up to rounding.
    let center = center.min(last - scale * (high - center)).max(first - scale * (low - center));
    Camera { fx: scale * camera.fx, fy: scale * camera.fy, cx: center.x, cy: center.y, ..*camera }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_moved_and_made_smaller_only_as_far_as_it_takes() {
        let camera = Camera::orbit(DVec3::ZERO, 5.0, 0.0, 0.0, 0.8, 200, 100);
        let seen = |camera: &Camera, points: &[DVec3]| {
            let inside = |p: &DVec3| {
                let q = camera.project(*p);
                q.x >= 7.9 && q.x <= 192.1 && q.y >= 3.9 && q.y <= 96.1
            };
            points.iter().all(inside)
        };
        let near = [DVec3::splat(-0.5), DVec3::splat(0.5)];
        assert_eq!(keep_in_view(&camera, &near), camera);
        let beside = near.map(|p| p + DVec3::X * 3.5);
        let moved = keep_in_view(&camera, &beside);
        assert!(!seen(&camera, &beside) && seen(&moved, &beside) && moved.fx == camera.fx && moved.cy == camera.cy);
        let large = near.map(|p| p * 9.0);
        let smaller = keep_in_view(&camera, &large);
        assert!(seen(&smaller, &large) && smaller.fx < camera.fx && smaller.fx / smaller.fy == camera.fx / camera.fy);
        assert_eq!(keep_in_view(&camera, &[]), camera);
    }

    #[test]
    fn every_preset_sees_the_whole_box_centred() {
        let bounds = (DVec3::new(-1.0, 2.0, 0.5), DVec3::new(3.0, 4.0, 1.5));
        for p in PRESETS {
            let c = preset(p.name, bounds, 512, 512).unwrap();
            assert!((c.project(0.5 * (bounds.0 + bounds.1)) - glam::DVec2::splat(256.0)).length() < 1e-9, "{}", p.name);
            for k in 0..8 {
                let corner = DVec3::select(glam::BVec3::new(k & 1 == 0, k & 2 == 0, k & 4 == 0), bounds.0, bounds.1);
                let q = c.project(corner);
                assert!(q.min_element() > 0.0 && q.max_element() < 512.0, "{}: {q}", p.name);
            }
        }
        assert!(preset("nowhere", bounds, 8, 8).unwrap_err().to_string().contains("reference"));
    }
}

//! Skeleton and weights from all sides.

use super::plain_studio;
use crate::Error;
use crate::event::Progress;
use crate::film::film;
use crate::pictures::Studio;
use crate::turntable::overlays::{colored_by_weights, draw_bones};
use animimic_render::{Light, overlay};
use animimic_scene::{Asset, Camera, Image};
use glam::DVec3;
use std::path::Path;

/// Side of a view [px].
const VIEW_PX: u32 = 384;
/// Turntable: length [s] and rate.
const TURN_SECS: f64 = 4.0;
const FPS: f64 = 24.0;
/// Height from which the turntable looks [rad], and its field of view [rad]: nearly without perspective.
const ELEVATION_RAD: f64 = 0.2;
const VIEW_ANGLE_RAD: f64 = 0.2;
/// Distance of the camera [longest diagonal].
const DISTANCE: f64 = 5.2;
/// How much of the model's colours stays behind a skeleton.
const FAINT: f64 = 0.35;
const WHITE: [u8; 3] = [244, 245, 246];

/// A rigged model ready to be drawn: as it looks, and by its weights.
pub struct Sheet<'a> {
    asset: &'a Asset,
    looks: Studio,
    weights: Studio,
    center: DVec3,
    diagonal: f64,
}

impl<'a> Sheet<'a> {
    /// Prepares a rigged model.
    ///
    /// # Errors
    /// [`Error::Render`] for meshes that cannot be drawn.
    pub fn new(asset: &'a Asset) -> Result<Self, Error> {
        let (lo, hi) = asset.mesh.bounds();
        let colored = colored_by_weights(asset);
        Ok(Self {
            asset,
            looks: plain_studio(asset)?,
            weights: Studio::with_light(&colored, Light::default())?,
            center: 0.5 * (lo + hi),
            diagonal: (hi - lo).length(),
        })
    }

    /// The model at `positions` with joints at `joints` (faint, the skeleton in front) and its weights in colours, side by side.
    pub fn view(&self, azimuth_rad: f64, elevation_rad: f64, positions: &[DVec3], joints: &[DVec3]) -> Image {
        let size = VIEW_PX as usize;
        let camera = Camera::orbit(
            self.center,
            DISTANCE * self.diagonal,
            azimuth_rad,
            elevation_rad,
            VIEW_ANGLE_RAD,
            VIEW_PX,
            VIEW_PX,
        );
        let mut out = Image::filled(2 * size, size, WHITE);
        let (mut faint, _) = self.looks.draw(&camera, positions, WHITE);
        for p in &mut faint.rgb {
            *p = [0, 1, 2].map(|c| (f64::from(p[c]) * FAINT + f64::from(WHITE[c]) * (1.0 - FAINT)) as u8);
        }
        draw_bones(&mut faint, &camera, &self.asset.rig, joints);
        overlay::paste(&mut out, &faint, 0, 0);
        overlay::paste(&mut out, &self.weights.draw(&camera, positions, WHITE).0, size, 0);
        out
    }

    fn rest(&self) -> Vec<DVec3> {
        let skeleton = &self.asset.rig.skeleton;
        skeleton.rest_world().iter().map(|w| w.translation).collect()
    }
}

/// Four sides and the top in one picture.
///
/// # Errors
/// [`Error::Render`] for meshes that cannot be drawn.
pub fn sheet(asset: &Asset) -> Result<Image, Error> {
    let sheet = Sheet::new(asset)?;
    let joints = sheet.rest();
    let size = VIEW_PX as usize;
    let views: [(f64, f64); 6] = [(0.0, 0.0), (90.0, 0.0), (180.0, 0.0), (270.0, 0.0), (0.0, 89.0), (35.0, 20.0)];
    let mut out = Image::filled(4 * size, views.len() / 2 * size, WHITE);
    for (k, (azimuth, elevation)) in views.into_iter().enumerate() {
        let view = sheet.view(azimuth.to_radians(), elevation.to_radians(), &asset.mesh.positions, &joints);
        overlay::paste(&mut out, &view, k % 2 * 2 * size, k / 2 * size);
    }
    Ok(out)
}

/// Writes the model going once around as a video.
///
/// # Errors
/// Those of drawing and writing; a stop, after which there is no file.
pub fn turntable(asset: &Asset, path: &Path, progress: &mut Progress) -> Result<(), Error> {
    let sheet = Sheet::new(asset)?;
    let joints = sheet.rest();
    let frames = (TURN_SECS * FPS) as usize;
    let draw = |t: usize| {
        let turn = std::f64::consts::TAU * t as f64 / frames as f64;
        sheet.view(turn, ELEVATION_RAD, &asset.mesh.positions, &joints)
    };
    film(path, (frames, FPS), (0.0, 1.0), draw, progress)
}

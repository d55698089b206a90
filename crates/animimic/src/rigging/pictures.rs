//! Skeleton and weights from all sides.

use super::plain_studio;
use crate::Error;
use crate::event::Progress;
use crate::film::film;
use crate::pictures::Studio;
use animimic_render::{Light, overlay};
use animimic_scene::{Asset, Camera, Image, Look};
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
const BONE: [u8; 3] = [30, 70, 200];
const JOINT: [u8; 3] = [200, 40, 40];

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
        skeleton(&mut faint, &camera, self.asset, joints);
        overlay::paste(&mut out, &faint, 0, 0);
        overlay::paste(&mut out, &self.weights.draw(&camera, positions, WHITE).0, size, 0);
        out
    }

    fn rest(&self) -> Vec<DVec3> {
        let skeleton = &self.asset.rig.skeleton;
        skeleton.rest_world().iter().map(|w| w.translation).collect()
    }
}

fn skeleton(picture: &mut Image, camera: &Camera, asset: &Asset, joints: &[DVec3]) {
    for (j, joint) in asset.rig.skeleton.joints.iter().enumerate() {
        if let Some(p) = joint.parent {
            overlay::line(picture, camera.project(joints[p]), camera.project(joints[j]), 1.6, BONE, 1.0);
        }
    }
    joints.iter().for_each(|&p| overlay::disc(picture, camera.project(p), 2.6, JOINT, 1.0));
}

/// The model with colours of its joints, mixed by weight, instead of its looks.
fn colored_by_weights(asset: &Asset) -> Asset {
    let skin = &asset.rig.skin;
    let color = |joint: usize| {
        // Hues a golden angle apart: neighbours in the list differ most.
        let hue = joint as f64 * 0.618_034 * std::f64::consts::TAU;
        [0.0, 2.1, 4.2].map(|shift| 0.45 + 0.4 * (hue + shift).cos())
    };
    let colors = skin.influences.iter().map(|list| {
        let mut sum = [0.0f64; 3];
        for i in list {
            let c = color(skin.slots[i.slot as usize].joint);
            (0..3).for_each(|k| sum[k] += i.weight * c[k]);
        }
        sum.map(|v| v as f32)
    });
    let mut mesh = asset.mesh.clone();
    mesh.colors = colors.collect();
    mesh.parts.iter_mut().for_each(|p| p.look = 0);
    Asset { mesh, looks: vec![Look { double_sided: true, ..Look::default() }], ..Asset::default() }
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

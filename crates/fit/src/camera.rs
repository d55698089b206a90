//! Finds the camera from the first frame, in which the model stands as in its file.
//!
//! 1. A grid of azimuths and elevations; scale and shift follow from the bounding boxes of object and projection.
//! 2. Each is scored on a small picture: overlap of silhouettes minus unlikeness of colours where both are.
//! 3. The best few are improved by a pattern search (Hooke & Jeeves 1961) over azimuth, elevation, distance, shift and
//!    focal length, coarse to fine.
//!
//! The score is a step function of the parameters at pixel scale, hence no derivatives. Roll is taken to be zero.

use crate::FitError;
use animimic_render::{Light, Surface, rasterize_surface, shade};
use animimic_scene::{Asset, Camera, Image, Mask, mesh};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// A camera with how well the model fits the object's outline through it.
#[derive(Clone, Copy, Debug)]
pub struct FoundCamera {
    /// The camera, at the picture's size.
    pub camera: Camera,
    /// Intersection over union of silhouettes.
    pub iou: f64,
}

/// Azimuths tried.
const AZIMUTHS: usize = 24;
/// Elevations tried [rad].
const ELEVATIONS_RAD: [f64; 5] = [-0.17, 0.0, 0.17, 0.36, 0.6];
/// Field of view that the search starts with [rad]: 35–40° is what renderers' presets have.
const FIRST_FOV_Y_RAD: f64 = 0.65;
/// Heights of the pictures on which candidates are compared and improved [px].
const HEIGHTS_PX: [usize; 2] = [96, 192];
/// Candidates that are improved at each height.
const KEPT: [usize; 2] = [8, 2];
/// Weight of the mean colour difference in \[0, 1\] against overlap.
const COLOR_WEIGHT: f64 = 0.6;
/// Weight of the squared logarithm of focal length against its start: outlines hardly tell it.
const FOCAL_PRIOR: f64 = 0.004;

/// Azimuth, elevation [rad], ln(distance / diagonal), shift right and up [diagonals], ln(focal length / height).
type Parameters = [f64; 6];
/// First steps of the pattern search.
const STEPS: Parameters = [0.12, 0.08, 0.05, 0.02, 0.02, 0.12];
/// The search ends when steps are this share of the first ones, at each height.
const LAST_STEP: [f64; 2] = [1.0 / 16.0, 1.0 / 128.0];

/// Searches the camera of a picture that shows `asset` in its rest pose; `mask` is the object in it.
///
/// # Errors
/// [`FitError::Input`] for an empty mask or sizes that differ, [`FitError::Render`] for a model that cannot be drawn.
pub fn find_camera(asset: &Asset, image: &Image, mask: &Mask) -> Result<FoundCamera, FitError> {
    if (image.width, image.height) != (mask.width, mask.height) {
        return Err(FitError::Input("picture and mask differ in size".into()));
    }
    let Some(object) = bounds_of(mask) else {
        return Err(FitError::Input("no object was found in the first frame, so its camera cannot be".into()));
    };
    let surface = Surface::new(&asset.mesh, &asset.looks)?;
    let model = Model::new(asset, &surface, image, object);
    let scenes = HEIGHTS_PX.map(|h| Scene::new(&model, image, mask, h.min(image.height)));
    let grid: Vec<Parameters> = (0..AZIMUTHS)
        .flat_map(|a| ELEVATIONS_RAD.map(|e| (TAU * a as f64 / AZIMUTHS as f64 - PI, e)))
        .map(|(azimuth, elevation)| model.framed(azimuth, elevation))
        .collect();
    let mut ranked = rank(grid.into_par_iter().map(|p| (scenes[0].score(&p), p)).collect());
    for (k, scene) in scenes.iter().enumerate() {
        ranked.truncate(KEPT[k]);
        ranked = rank(ranked.into_par_iter().map(|(_, p)| scene.improved(p, LAST_STEP[k])).collect());
    }
    let camera = model.camera(&ranked[0].1);
    Ok(FoundCamera { camera, iou: Scene::new(&model, image, mask, image.height).overlap(&ranked[0].1) })
}

/// Best first; equal scores keep their order.
fn rank(mut candidates: Vec<(f64, Parameters)>) -> Vec<(f64, Parameters)> {
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
    candidates
}

/// The model and what the picture's frame says about it.
struct Model<'a> {
    surface: &'a Surface,
    positions: &'a [DVec3],
    center: DVec3,
    diagonal: f64,
    width: u32,
    height: u32,
    /// Corners of the object's box [px].
    object: (DVec2, DVec2),
}

impl<'a> Model<'a> {
    fn new(asset: &'a Asset, surface: &'a Surface, image: &Image, object: (DVec2, DVec2)) -> Self {
        let (low, high) = mesh::bounds(&asset.mesh.positions);
        Self {
            surface,
            positions: &asset.mesh.positions,
            center: 0.5 * (low + high),
            diagonal: (high - low).length().max(f64::MIN_POSITIVE),
            width: image.width as u32,
            height: image.height as u32,
            object,
        }
    }

    fn camera(&self, p: &Parameters) -> Camera {
        let [azimuth, elevation, ln_distance, right, up, ln_focal] = *p;
        let distance = ln_distance.exp() * self.diagonal;
        let fov = 2.0 * (0.5 / ln_focal.exp()).atan();
        let mut camera = Camera::orbit(self.center, distance, azimuth, elevation, fov, self.width, self.height);
        // Moving the model right in the picture is a translation in view space (x right, y down).
        camera.view_from_world.translation += DVec3::new(right, -up, 0.0) * self.diagonal;
        camera
    }

    /// Distance and shift for which the projected box covers the object's box.
    fn framed(&self, azimuth: f64, elevation: f64) -> Parameters {
        let focal = 0.5 / (0.5 * FIRST_FOV_Y_RAD).tan();
        let mut p = [azimuth, elevation, 1.0, 0.0, 0.0, focal.ln()];
        // Perspective makes box and distance interact; three rounds settle to a fraction of a pixel.
        for _ in 0..4 {
            let camera = self.camera(&p);
            let (low, high) = self
                .positions
                .iter()
                .map(|&x| camera.project(x))
                .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), q| (lo.min(q), hi.max(q)));
            let (own, wanted) = (high - low, self.object.1 - self.object.0);
            if !own.is_finite() || own.min_element() <= 0.0 {
                break;
            }
            p[2] += 0.5 * (own.x * own.y / (wanted.x * wanted.y)).ln();
            let depth = p[2].exp();
            let shift = 0.5 * (self.object.0 + self.object.1 - low - high) * depth / camera.fy;
            p[3] += shift.x;
            p[4] -= shift.y;
        }
        p
    }
}

/// The picture at one size.
struct Scene<'a> {
    model: &'a Model<'a>,
    width: usize,
    height: usize,
    /// sRGB-encoded, in [0, 1].
    rgb: Vec<[f32; 3]>,
    inside: Vec<bool>,
}

impl<'a> Scene<'a> {
    fn new(model: &'a Model, image: &Image, mask: &Mask, height: usize) -> Self {
        let width = (image.width * height).div_ceil(image.height);
        let mut rgb = vec![[0.0f32; 3]; width * height];
        let mut share = vec![0.0f32; width * height];
        let mut count = vec![0.0f32; width * height];
        for y in 0..image.height {
            for x in 0..image.width {
                let at = y * height / image.height * width + x * width / image.width;
                let c = image.at(x, y);
                (0..3).for_each(|k| rgb[at][k] += f32::from(c[k]) / 255.0);
                share[at] += f32::from(mask.coverage[y * mask.width + x]) / 255.0;
                count[at] += 1.0;
            }
        }
        rgb.iter_mut().zip(&count).for_each(|(c, n)| c.iter_mut().for_each(|v| *v /= n.max(1.0)));
        let inside = share.iter().zip(&count).map(|(s, n)| *s >= 0.5 * n.max(1.0)).collect();
        Self { model, width, height, rgb, inside }
    }

    /// Overlap of silhouettes minus unlikeness of colours; the prior of the focal length.
    fn score(&self, p: &Parameters) -> f64 {
        let camera = self.model.camera(p).resized(self.width as u32, self.height as u32);
        let raster = rasterize_surface(&camera, self.model.surface, self.model.positions, false);
        let drawn =
            shade(&camera, self.model.surface, self.model.positions, &raster, &Light::default(), [0.0; 3], false);
        let (mut both, mut any) = (Vec::new(), 0usize);
        for (i, &inside) in self.inside.iter().enumerate() {
            any += usize::from(inside || raster.covered(i));
            if inside && raster.covered(i) {
                both.push(i);
            }
        }
        if both.is_empty() {
            return 0.0;
        }
        let first = 0.5 / (0.5 * FIRST_FOV_Y_RAD).tan();
        both.len() as f64 / any as f64
            - COLOR_WEIGHT * self.unlikeness(&drawn, &both)
            - FOCAL_PRIOR * (p[5] - first.ln()).powi(2)
    }

    /// Mean absolute colour difference after the best gain per channel, which stands in for unknown light.
    fn unlikeness(&self, drawn: &[[f32; 3]], both: &[usize]) -> f64 {
        let mut total = 0.0;
        for c in 0..3 {
            let (mut cross, mut own) = (0.0, 1e-12);
            for &i in both {
                cross += f64::from(drawn[i][c]) * f64::from(self.rgb[i][c]);
                own += f64::from(drawn[i][c]).powi(2);
            }
            let gain = cross / own;
            total +=
                both.iter().map(|&i| (gain * f64::from(drawn[i][c]) - f64::from(self.rgb[i][c])).abs()).sum::<f64>();
        }
        total / (3 * both.len()) as f64
    }

    fn overlap(&self, p: &Parameters) -> f64 {
        let camera = self.model.camera(p).resized(self.width as u32, self.height as u32);
        let raster = rasterize_surface(&camera, self.model.surface, self.model.positions, false);
        let covered = |i: usize| raster.covered(i);
        let both = self.inside.iter().enumerate().filter(|(i, m)| **m && covered(*i)).count();
        let any = self.inside.iter().enumerate().filter(|(i, m)| **m || covered(*i)).count();
        both as f64 / any.max(1) as f64
    }

    /// Hooke & Jeeves: along each axis keep what is better; after a round without gain halve the steps.
    fn improved(&self, mut p: Parameters, last_step: f64) -> (f64, Parameters) {
        let (mut best, mut size) = (self.score(&p), 1.0);
        while size >= last_step {
            let before = p;
            for k in 0..p.len() {
                for sign in [1.0, -1.0] {
                    let mut q = p;
                    q[k] += sign * size * STEPS[k];
                    // A longer lens from farther away leaves the size as it is.
                    if k == 5 {
                        q[2] += sign * size * STEPS[k];
                    }
                    let score = self.score(&q);
                    if score > best {
                        (best, p) = (score, q);
                        break;
                    }
                }
            }
            if p == before {
                size *= 0.5;
            }
        }
        (best, p)
    }
}

/// Corners of the box around the pixels inside.
fn bounds_of(mask: &Mask) -> Option<(DVec2, DVec2)> {
    let mut out: Option<(DVec2, DVec2)> = None;
    for y in 0..mask.height {
        for x in (0..mask.width).filter(|&x| mask.inside(x, y)) {
            let (a, b) = (DVec2::new(x as f64, y as f64), DVec2::new(x as f64 + 1.0, y as f64 + 1.0));
            out = Some(out.map_or((a, b), |(lo, hi)| (lo.min(a), hi.max(b))));
        }
    }
    out
}

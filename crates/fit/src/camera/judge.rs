//! How much a drawing of the model looks like frame 0.
//!
//! The light is solved anew for each camera (spherical harmonics, robust), so that a verdict does not depend on it. What is
//! left are colours and markings: the mean capped colour difference over the union, and 1 − the correlation of luma slopes,
//! which sees markings and creases even on plain grey models, whose colours any light explains.

use super::Scene;
use crate::color::luma;
use animimic_render::{Light, NONE, Raster, rasterize_surface, shade, solve_light};
use animimic_scene::Camera;

/// Colour differences above this say no more than "wrong".
const COLOR_CAP: f64 = 0.3;
/// Weights of 1 − IoU, colour difference and slopes in the total. The first two are of the same size for near misses; slopes
/// break ties.
const SILHOUETTE_WEIGHT: f64 = 1.0;
const COLOR_WEIGHT: f64 = 2.0;
const SLOPE_WEIGHT: f64 = 0.2;

/// The parts of a verdict.
#[derive(Clone, Copy, Debug)]
pub struct Verdict {
    /// Overlap of silhouettes.
    pub iou: f64,
    /// Mean capped colour difference where both show the object, in [0, 1].
    pub color: f64,
    /// 1 − correlation of luma slopes inside, in [0, 2].
    pub slope: f64,
}

impl Verdict {
    /// Smaller is better.
    pub fn total(&self) -> f64 {
        SILHOUETTE_WEIGHT * (1.0 - self.iou) + COLOR_WEIGHT * self.color + SLOPE_WEIGHT * self.slope
    }
}

/// The light that explains the frame best with this camera; a neutral one where the model is out of sight.
pub fn light(scene: &Scene, camera: &Camera, raster: &Raster) -> Light {
    solve_light(camera, scene.surface, scene.positions, raster, scene.frame, Some(scene.mask)).unwrap_or_default()
}

/// Draws the model and compares.
pub fn verdict(scene: &Scene, camera: &Camera) -> Verdict {
    let raster = rasterize_surface(camera, scene.surface, scene.positions, false);
    let iou = raster.mask().iou(scene.mask);
    let light = light(scene, camera, &raster);
    let drawn = shade(camera, scene.surface, scene.positions, &raster, &light, [0.0; 3], false);
    let (w, h) = (raster.width, raster.height);
    let both = |i: usize| raster.triangle[i] != NONE && scene.mask.coverage[i] >= 128;
    let seen = |i: usize| scene.frame.rgb[i].map(|c| f64::from(c) / 255.0);
    let (mut color, mut count) = (0.0, 0usize);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let i = y * w + x;
            if !both(i) {
                continue;
            }
            let (a, b) = (drawn[i].map(f64::from), seen(i));
            color += ((0..3).map(|c| (a[c] - b[c]).abs()).sum::<f64>() / 3.0).min(COLOR_CAP);
            count += 1;
            for (before, after) in [(i - 1, i + 1), (i - w, i + w)] {
                if both(before) && both(after) {
                    let da = luma(drawn[after].map(f64::from)) - luma(drawn[before].map(f64::from));
                    let db = luma(seen(after)) - luma(seen(before));
                    (ab, aa, bb) = (ab + da * db, aa + da * da, bb + db * db);
                }
            }
        }
    }
    let correlation = if aa * bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 };
    Verdict { iou, color: if count == 0 { COLOR_CAP } else { color / count as f64 }, slope: 1.0 - correlation }
}

//! Coarse search: which directions show a silhouette of the mask's shape.
//!
//! Silhouettes are compared after both were moved to a common centroid and area, so that one drawing per direction and
//! field of view serves every distance and shift. With n the ratio of lengths (√ of areas), the distance is d·n and the
//! shift follows from the centroids: both closed form, up to the change of perspective, which refinement takes out.

use super::Scene;
use animimic_render::rasterize;
use animimic_scene::{Camera, Mask};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Vertical fields of view that are tried [degree].
const FIELDS_DEG: [f64; 3] = [22.0, 38.0, 58.0];
/// Azimuths that are tried, evenly around.
const AZIMUTHS: usize = 24;
/// Elevations that are tried [degree].
const ELEVATIONS_DEG: [f64; 8] = [-20.0, -10.0, 0.0, 10.0, 20.0, 30.0, 40.0, 50.0];
/// Side of the pictures of the search [px].
const SIDE: u32 = 96;
/// Share of the picture that the model's bounding sphere fills.
const FILLED: f64 = 0.95;
/// Side of the grid on which shapes are compared, and the square root of the shape's area on it [cell].
const GRID: usize = 80;
const GRID_ROOT_AREA: f64 = 22.0;

/// Cameras for the frame, most similar silhouettes first; one per direction (the best field of view).
pub fn views(scene: &Scene) -> Vec<Camera> {
    let Some(wanted) = Shape::new(scene.mask) else { return Vec::new() };
    let directions: Vec<(f64, f64)> = ELEVATIONS_DEG
        .iter()
        .flat_map(|e| (0..AZIMUTHS).map(move |a| (a as f64 * TAU / AZIMUTHS as f64, e.to_radians())))
        .collect();
    let mut found: Vec<(f64, Camera)> = directions
        .par_iter()
        .filter_map(|&(azimuth, elevation)| {
            FIELDS_DEG
                .iter()
                .filter_map(|fov| view(scene, &wanted, azimuth, elevation, fov.to_radians()))
                .max_by(|a, b| a.0.total_cmp(&b.0))
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|f| f.1).collect()
}

/// The camera of one direction and field of view, with the overlap of the shapes.
fn view(scene: &Scene, wanted: &Shape, azimuth: f64, elevation: f64, fov: f64) -> Option<(f64, Camera)> {
    let (w, h) = (scene.mask.width as u32, scene.mask.height as u32);
    let frame = |distance| Camera::orbit(scene.center, distance, azimuth, elevation, fov, w, h);
    // The trial picture: the sphere fills a square picture, with the perspective of the distance at which it does.
    let focal = 0.5 * f64::from(h) / (0.5 * fov).tan();
    let distance = scene.radius * focal / (wanted.reach * FILLED.recip());
    let distance = distance.max(1.2 * scene.radius);
    let trial_focal =
        0.5 * f64::from(SIDE) * FILLED * (distance * distance - scene.radius.powi(2)).sqrt() / scene.radius;
    let trial = Camera {
        width: SIDE,
        height: SIDE,
        fx: trial_focal,
        fy: trial_focal,
        cx: 0.5 * f64::from(SIDE),
        cy: 0.5 * f64::from(SIDE),
        ..frame(distance)
    };
    let drawn = Shape::new(&rasterize(&trial, scene.positions, &scene.surface.triangles).mask())?;
    let overlap = wanted.overlap(&drawn);
    // Size: root areas scale with focal / distance. Place: the centroid's offset from the projected centre, rescaled.
    let ratio = wanted.root_area / drawn.root_area;
    let new_distance = (distance * focal / (trial_focal * ratio)).max(1.05 * scene.radius);
    let mut camera = frame(new_distance);
    let offset = (drawn.centroid - DVec2::splat(0.5 * f64::from(SIDE))) * ratio;
    let center_px = wanted.centroid - offset;
    let shift = (center_px - DVec2::new(camera.cx, camera.cy)) * new_distance / focal;
    camera.view_from_world.translation += DVec3::new(shift.x, shift.y, 0.0);
    Some((overlap, camera))
}

/// A silhouette with its centroid and size, and itself on the common grid.
struct Shape {
    centroid: DVec2,
    root_area: f64,
    /// Largest distance of a pixel from the centroid [px].
    reach: f64,
    grid: Vec<bool>,
}

impl Shape {
    fn new(mask: &Mask) -> Option<Self> {
        let inside = || (0..mask.width * mask.height).filter(|&i| mask.coverage[i] >= 128);
        let at = |i: usize| DVec2::new((i % mask.width) as f64 + 0.5, (i / mask.width) as f64 + 0.5);
        let count = inside().count();
        if count == 0 {
            return None;
        }
        let centroid = inside().map(at).sum::<DVec2>() / count as f64;
        let reach = inside().map(|i| at(i).distance(centroid)).fold(1.0, f64::max);
        let root_area = (count as f64).sqrt();
        let step = root_area / GRID_ROOT_AREA;
        let grid = (0..GRID * GRID)
            .map(|i| {
                let cell = DVec2::new((i % GRID) as f64, (i / GRID) as f64) + 0.5 - 0.5 * GRID as f64;
                let p = centroid + cell * step;
                let (x, y) = (p.x.floor(), p.y.floor());
                let in_picture = x >= 0.0 && y >= 0.0 && x < mask.width as f64 && y < mask.height as f64;
                in_picture && mask.inside(x as usize, y as usize)
            })
            .collect();
        Some(Self { centroid, root_area, reach, grid })
    }

    /// Intersection over union on the grid.
    fn overlap(&self, other: &Shape) -> f64 {
        let pairs = || self.grid.iter().zip(&other.grid);
        let both = pairs().filter(|(a, b)| **a && **b).count();
        let any = pairs().filter(|(a, b)| **a || **b).count();
        both as f64 / any.max(1) as f64
    }
}

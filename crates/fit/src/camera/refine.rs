//! Refinement of a camera: Levenberg–Marquardt over seven parameters.
//!
//! With x fixed in the world, v = R x + t, the parameters change R ← exp([ω]×) R, t ← t + τ·s, f ← f·exp(φ), so that
//! ∂v/∂ω = [−R x]×, ∂v/∂τ = s·I; u = f·v.x/v.z + cx gives ∂u/∂v = f/v.z·(1, 0, −v.x/v.z) and ∂u/∂φ = u − cx; likewise v.
//! Residuals are signed distances along a direction n: nᵀ(u − target), under a robust loss, with correspondences found
//! anew after each solve (iterated closest points, with flow as a second source).
//! Focal length and distance are nearly exchangeable; a weak pull of φ to where the round began keeps them from drifting.

use super::{Scene, judge};
use crate::color::{color_distance, luma};
use crate::robust::Robust;
use crate::schedule::geometric;
use crate::stage1::contour::Contour;
use crate::stage1::sight::drawn_over;
use animimic_math::small_spd::solve_spd;
use animimic_render::{NONE, Raster, rasterize_surface, shade};
use animimic_scene::{Camera, Image};
use glam::{DMat3, DQuat, DVec2, DVec3};

/// Number of parameters: ω, τ, φ.
const N: usize = 7;
/// Rounds of drawing and solving on silhouettes.
const SILHOUETTE_ROUNDS: usize = 8;
/// Rounds with flow.
const FLOW_ROUNDS: usize = 5;
/// Contour pairs and flow points wanted.
const CONTOUR_POINTS: usize = 400;
const FLOW_POINTS: usize = 800;
/// Reach of contour pairs in the first and last round, as a share of the picture's height.
const REACH: (f64, f64) = (0.08, 0.012);
/// Robust threshold in the first and last round, as a share of the picture's height.
const HUBER: (f64, f64) = (0.02, 0.003);
/// Pull of φ towards the round's start, as a share of the mean weight.
const FOCAL_PULL: f64 = 0.05;
/// Weight of the flow against the contour.
const FLOW_WEIGHT: f64 = 1.0;
/// Colour difference at which a flow target's weight has dropped to 1/e.
const COLOR_SIGMA: f64 = 0.12;
/// LM steps per round.
const STEPS: usize = 6;
/// Distance to the silhouette below which flow is not trusted [px].
const EDGE_MARGIN: usize = 3;

/// One residual: nᵀ(project(x) − target).
#[derive(Clone, Copy, Debug)]
struct Pair {
    point: DVec3,
    target: DVec2,
    direction: DVec2,
    weight: f64,
}

/// Refines on silhouettes alone.
pub fn by_silhouette(scene: &Scene, camera: &Camera) -> Camera {
    refined(scene, camera, SILHOUETTE_ROUNDS, 1.0, false)
}

/// Refines on silhouettes and appearance, from nearer by.
pub fn with_flow(scene: &Scene, camera: &Camera) -> Camera {
    refined(scene, camera, FLOW_ROUNDS, 0.5, true)
}

/// Draws and solves in turn; `first` is a factor on reach and threshold of the first round.
fn refined(scene: &Scene, camera: &Camera, rounds: usize, first: f64, appearance: bool) -> Camera {
    let mut camera = *camera;
    let height = f64::from(camera.height);
    for round in 0..rounds {
        let u = round as f64 / (rounds - 1) as f64;
        let px = |range: (f64, f64)| geometric((first * range.0, range.1), u) * height;
        let raster = rasterize_surface(&camera, scene.surface, scene.positions, false);
        let mut pairs = Vec::new();
        contour_pairs(scene, &raster, px(REACH), &mut pairs);
        if appearance {
            flow_pairs(scene, &camera, &raster, &mut pairs);
        }
        camera = solve(&camera, scene.radius, &pairs, px(HUBER));
    }
    camera
}

/// World point at a covered pixel.
fn surface_point(scene: &Scene, raster: &Raster, pixel: usize) -> DVec3 {
    let corners = scene.surface.triangles[raster.triangle[pixel] as usize];
    let b = raster.weights(pixel).map(f64::from);
    (0..3).map(|k| scene.positions[corners[k] as usize] * b[k]).sum()
}

/// Contour pairs, from the rendered to the observed contour and back.
fn contour_pairs(scene: &Scene, raster: &Raster, reach: f64, pairs: &mut Vec<Pair>) {
    let rendered = Contour::new(&raster.mask());
    let observed = &scene.contour;
    let found: Vec<Pair> = rendered
        .pairs(observed, reach, CONTOUR_POINTS)
        .into_iter()
        .map(|(r, o)| {
            let p = rendered.points[r];
            let point = surface_point(scene, raster, p.y as usize * raster.width + p.x as usize);
            Pair { point, target: observed.points[o], direction: observed.normals[o], weight: 1.0 }
        })
        .collect();
    append_mean(found, 1.0, pairs);
}

/// Appends pairs so that their weights sum to `total`.
fn append_mean(found: Vec<Pair>, total: f64, pairs: &mut Vec<Pair>) {
    let scale = total / found.len().max(50) as f64;
    pairs.extend(found.into_iter().map(|p| Pair { weight: p.weight * scale, ..p }));
}

/// Flow from the drawing to the frame at a grid of points away from the silhouette.
fn flow_pairs(scene: &Scene, camera: &Camera, raster: &Raster, pairs: &mut Vec<Pair>) {
    let light = judge::light(scene, camera, raster);
    let rgb = shade(camera, scene.surface, scene.positions, raster, &light, [0.0; 3], false);
    let drawn = drawn_over(scene.background, raster, &rgb);
    let vectors = (scene.flow)(&drawn, scene.frame);
    let (w, h) = (raster.width, raster.height);
    let covered = raster.triangle.iter().filter(|&&t| t != NONE).count();
    let stride = ((covered as f64 / FLOW_POINTS as f64).sqrt().round() as usize).max(1);
    let m = EDGE_MARGIN;
    let mut found = Vec::new();
    for y in (m..h.saturating_sub(m)).step_by(stride) {
        for x in (m..w.saturating_sub(m)).step_by(stride) {
            let i = y * w + x;
            let inside = [i, i - m, i + m, i - m * w, i + m * w].iter().all(|&j| raster.triangle[j] != NONE);
            let v = vectors[i].map(f64::from);
            let target = DVec2::new(x as f64 + 0.5 + v[0], y as f64 + 0.5 + v[1]);
            let (tx, ty) = (target.x.floor(), target.y.floor());
            if !inside || tx < 0.0 || ty < 0.0 || tx >= w as f64 || ty >= h as f64 {
                continue;
            }
            let j = ty as usize * w + tx as usize;
            if scene.mask.coverage[j] < 128 {
                continue;
            }
            let difference = color_distance(drawn.rgb[i], scene.frame.rgb[j]) / 255.0;
            let slope = steepness(&drawn, x, y);
            let weight = (-(difference / COLOR_SIGMA).powi(2)).exp() * slope;
            let point = surface_point(scene, raster, i);
            found.extend([DVec2::X, DVec2::Y].map(|direction| Pair { point, target, direction, weight }));
        }
    }
    append_mean(found, FLOW_WEIGHT, pairs);
}

/// How much there is to follow around a pixel, in [0, 1]: squared luma slope against a noise level.
fn steepness(image: &Image, x: usize, y: usize) -> f64 {
    const NOISE: f64 = 20.0;
    let luma = |x: usize, y: usize| luma(image.at(x, y).map(f64::from));
    let (gx, gy) = (luma(x + 2, y) - luma(x - 2, y), luma(x, y + 2) - luma(x, y - 2));
    let e = gx * gx + gy * gy;
    e / (e + NOISE * NOISE)
}

/// The camera moved by a step of the parameters; `unit` is the length of τ's unit.
fn moved(camera: &Camera, unit: f64, step: &[f64; N]) -> Camera {
    let omega = DVec3::new(step[0], step[1], step[2]);
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(omega));
    let mut out = *camera;
    out.view_from_world.matrix3 = turn * camera.view_from_world.matrix3;
    out.view_from_world.translation += DVec3::new(step[3], step[4], step[5]) * unit;
    out.fx *= step[6].exp();
    out.fy *= step[6].exp();
    out
}

/// Residual and its row.
fn residual(camera: &Camera, unit: f64, pair: &Pair) -> (f64, [f64; N]) {
    let turned = camera.view_from_world.matrix3 * pair.point;
    let v = turned + camera.view_from_world.translation;
    let pixel = camera.pixel_from_view(v);
    let n = pair.direction;
    let (fx, fy) = (camera.fx / v.z, camera.fy / v.z);
    let d_v = DVec3::new(n.x * fx, n.y * fy, -(n.x * fx * v.x + n.y * fy * v.y) / v.z);
    // dᵀ(ω × a) = ωᵀ(a × d).
    let d_omega = turned.cross(d_v);
    let d_focal = n.x * (pixel.x - camera.cx) + n.y * (pixel.y - camera.cy);
    let row = [d_omega.x, d_omega.y, d_omega.z, d_v.x * unit, d_v.y * unit, d_v.z * unit, d_focal];
    (n.dot(pixel - pair.target), row)
}

fn energy(camera: &Camera, unit: f64, pairs: &[Pair], robust: Robust) -> f64 {
    let ahead = |p: &Pair| camera.to_view(p.point).z > 0.0;
    if !pairs.iter().all(ahead) {
        return f64::INFINITY;
    }
    pairs.iter().map(|p| p.weight * robust.loss(residual(camera, unit, p).0.abs())).sum()
}

/// Levenberg–Marquardt for fixed pairs.
fn solve(start: &Camera, unit: f64, pairs: &[Pair], huber_px: f64) -> Camera {
    let robust = Robust::Huber(huber_px);
    let mut camera = *start;
    let mut damping = 1e-3;
    let (mut focal, pull) = (0.0, FOCAL_PULL * (0.1 * f64::from(start.height)).powi(2) * 0.01);
    let mut e = energy(&camera, unit, pairs, robust);
    for _ in 0..STEPS {
        let (mut a, mut b) = ([[0.0; N]; N], [0.0; N]);
        for p in pairs {
            let (r, row) = residual(&camera, unit, p);
            let w = p.weight * robust.weight(r.abs().max(1e-9));
            for i in 0..N {
                b[i] -= w * row[i] * r;
                (0..N).for_each(|j| a[i][j] += w * row[i] * row[j]);
            }
        }
        a[6][6] += pull;
        b[6] -= pull * focal;
        let mut accepted = false;
        for _ in 0..6 {
            let mut damped = a;
            (0..N).for_each(|i| damped[i][i] += damping * a[i][i] + 1e-12);
            let Some(step) = solve_spd(damped, b) else { break };
            let next = moved(&camera, unit, &step);
            let next_focal = focal + step[6];
            let next_e = energy(&next, unit, pairs, robust);
            if next_e + pull * next_focal * next_focal < e + pull * focal * focal {
                (camera, e, focal, accepted) = (next, next_e, next_focal, true);
                damping = (damping * 0.2).max(1e-7);
                break;
            }
            damping *= 8.0;
        }
        if !accepted {
            break;
        }
    }
    camera
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};

    fn cloud(rng: &mut SplitMix64, n: usize) -> Vec<DVec3> {
        (0..n).map(|_| DVec3::new(rng.normal(), rng.normal(), rng.normal()) * 0.4).collect()
    }

    #[test]
    fn the_row_of_a_residual_is_its_gradient() {
        let mut rng = SplitMix64(3);
        let camera = Camera::orbit(DVec3::new(0.1, 0.2, 0.0), 3.0, 0.7, 0.3, 0.8, 320, 200);
        for point in cloud(&mut rng, 12) {
            let direction = DVec2::new(rng.normal(), rng.normal()).normalize();
            let pair = Pair { point, target: DVec2::new(100.0, 80.0), direction, weight: 1.0 };
            let row = residual(&camera, 0.7, &pair).1;
            let f = |x: &[f64]| residual(&moved(&camera, 0.7, &std::array::from_fn(|i| x[i])), 0.7, &pair).0;
            let error = gradient_error(f, &[0.0; N], &row, 8, &[1e-4, 1e-5, 1e-6], 1);
            assert!(error < 1e-7, "{error:.2e}");
        }
    }

    #[test]
    fn exact_pairs_bring_the_camera_back() {
        let mut rng = SplitMix64(4);
        let truth = Camera::orbit(DVec3::ZERO, 3.0, 0.7, 0.3, 0.8, 320, 320);
        let pairs: Vec<Pair> = cloud(&mut rng, 60)
            .into_iter()
            .flat_map(|point| {
                let target = truth.project(point);
                [DVec2::X, DVec2::Y].map(|direction| Pair { point, target, direction, weight: 1.0 / 120.0 })
            })
            .collect();
        let mut camera = moved(&truth, 1.0, &[0.1, -0.15, 0.08, 0.1, -0.05, 0.3, 0.05]);
        for _ in 0..12 {
            camera = solve(&camera, 1.0, &pairs, 10.0);
        }
        let worst = pairs.iter().map(|p| camera.project(p.point).distance(p.target)).fold(0.0, f64::max);
        println!("worst reprojection error {worst:.2e} px");
        assert!(worst < 0.05, "{worst}");
    }
}

//! The recorded gradient test: ∂Σ(mask − target)²/∂(93 pose parameters) against an 8×8-supersampled reference.

use crate::support::quadruped::{Quadruped, recorded_order};
use animimic_render::{Cotangents, Light, render, render_vjp};
use animimic_scene::Look;
use animimic_scene::io::npz;
use std::path::Path;

/// How two gradients agree.
pub struct Quality {
    /// Cosine of the angle between them.
    pub cosine: f64,
    /// Length of ours over the reference's.
    pub norm_ratio: f64,
    /// |difference| over the reference's length.
    pub relative_error: f64,
}

/// The quadruped as the rivals draw it: unlit.
pub fn unlit(data: &Path, mesh: &str) -> Quadruped {
    Quadruped::read(data, mesh, Look { unlit: true, double_sided: true, ..Look::default() })
}

/// Compares `g` with a reference.
pub fn compare(g: &[f64], reference: &[f64]) -> Quality {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (norm, length) = (dot(g, g).sqrt(), dot(reference, reference).sqrt());
    let difference: Vec<f64> = g.iter().zip(reference).map(|(a, b)| a - b).collect();
    Quality {
        cosine: dot(g, reference) / (norm * length),
        norm_ratio: norm / length,
        relative_error: dot(&difference, &difference).sqrt() / length,
    }
}

/// Runs the test on `maskgrad.npz`.
pub fn quality(data: &Path) -> Quality {
    let file = npz::read(data.join("maskgrad.npz")).expect("the benchmark's gradient test is readable");
    let numbers = |name: &str| file.need(name).expect("the benchmark's file has this array").to_f64();
    let scene = unlit(data, "2k");
    let pose = scene.pose(numbers("pose_frame")[0] as usize);
    let camera = scene.camera(numbers("size")[0] as u32);
    let target = numbers("target_mask");
    let vertices = scene.posed(&pose);
    let light = Light::ambient(1.0);
    let rendered = render(&camera, &scene.surface, &vertices, &light, [1.0; 3]);
    let mask: Vec<f32> =
        (0..target.len()).map(|p| 2.0 * (f32::from(u8::from(rendered.raster.covered(p))) - target[p] as f32)).collect();
    let d = Cotangents { mask: &mask, ..Cotangents::default() };
    let gradients = render_vjp(&camera, &scene.surface, &vertices, &light, &rendered, &d, false);
    compare(&recorded_order(&scene.pose_vjp(&pose, &gradients.positions)), &numbers("fd_gradient"))
}

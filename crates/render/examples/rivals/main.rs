//! The renderer against recorded rivals: speed and gradient quality.
//!
//! `cargo run --release -p animimic-render --example rivals -- DIR` with DIR the folder of the recorded scenes
//! (`data/quad_*.npz`, `data/maskgrad.npz`). One JSON line per mesh and size (CPU milliseconds of one thread, the least of
//! several repetitions), then one for the mask gradient test.

mod maskgrad;
mod quadruped;

use animimic_render::{Cotangents, Light, NONE, Rendered, render_into, render_vjp};
use quadruped::Quadruped;
use std::path::Path;

const REPETITIONS: usize = 40;

/// CPU time of this thread [ms].
fn cpu_ms() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}

/// Cotangents of mean |rgba|.
fn mean_abs(rendered: &Rendered, rgb: &mut Vec<[f32; 3]>, mask: &mut Vec<f32>) {
    let share = 1.0 / (4 * rendered.rgb.len()) as f32;
    rgb.clear();
    rgb.extend(rendered.rgb.iter().map(|p| p.map(|c| share * c.signum())));
    mask.clear();
    mask.extend(rendered.raster.triangle.iter().map(|&t| if t == NONE { 0.0 } else { share }));
}

fn main() {
    let Some(folder) = std::env::args().nth(1) else {
        eprintln!("usage: rivals DIR (the folder that holds data/quad_2k.npz)");
        std::process::exit(2);
    };
    let data = Path::new(&folder).join("data");
    for size in [256, 512] {
        for mesh in ["2k", "10k", "40k"] {
            let scene = Quadruped::read(&data, mesh);
            let camera = scene.camera(size);
            let vertices = scene.vertices(&scene.pose(20));
            let light = Light::ambient(1.0);
            let mut rendered = Rendered::default();
            let (mut rgb, mut mask) = (Vec::new(), Vec::new());
            let (mut forward, mut backward) = (f64::INFINITY, f64::INFINITY);
            for _ in 0..REPETITIONS {
                let start = cpu_ms();
                render_into(&camera, &scene.surface, &vertices, &light, [1.0; 3], &mut rendered);
                let middle = cpu_ms();
                mean_abs(&rendered, &mut rgb, &mut mask);
                let d = Cotangents { rgb: &rgb, mask: &mask, depth: &[] };
                let gradients = render_vjp(&camera, &scene.surface, &vertices, &light, &rendered, &d, false);
                assert!(gradients.positions.iter().all(|g| g.is_finite()), "gradients are numbers");
                forward = forward.min(middle - start);
                backward = backward.min(cpu_ms() - middle);
            }
            println!(
                r#"{{"mesh": "{mesh}", "size": {size}, "fwd_ms": {forward:.3}, "bwd_ms": {backward:.3}, "threads": 1}}"#
            );
        }
    }
    let q = maskgrad::quality(&data);
    println!(
        r#"{{"gradient_cosine": {:.5}, "norm_ratio": {:.4}, "rel_error": {:.4}}}"#,
        q.cosine, q.norm_ratio, q.relative_error
    );
}

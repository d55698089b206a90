//! The renderer against recorded rivals: speed and gradient quality.
//!
//! `cargo run --release -p animimic-fit --example rivals -- DIR` with DIR the folder of the recorded scenes
//! (`data/quad_*.npz`, `data/maskgrad.npz`). One JSON line per mesh and size (CPU milliseconds of one thread, the least of
//! several repetitions), then one for the mask gradient test and one for the refinement of a
//! pose. With a second argument, the path of `docs/benchmarks.md`, the
//! table there is written anew.

mod maskgrad;
mod refine;
#[path = "../../benches/support/mod.rs"]
mod support;

use animimic_render::{Cotangents, Light, NONE, Rendered, render_into, render_vjp};
use std::path::Path;
use support::thread_cpu_seconds;

const REPETITIONS: usize = 40;

/// DRTK's recorded CPU kernels, forward and backward [ms]: size, then 2k, 10k and 40k faces.
const RECORDED_MS: [(u32, [f64; 3]); 2] = [(256, [22.5, 23.2, 28.3]), (512, [99.5, 103.0, 110.0])];

/// Writes the renderer's table between its marks in `docs/benchmarks.md`.
fn write_table(path: &str, rows: &str, q: &maskgrad::Quality, r: &refine::Refinement) {
    const MARKS: [&str; 2] = ["<!-- renderer: generated -->", "<!-- /renderer -->"];
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let generated = format!(
        "{}\nCPU milliseconds of one thread, colour and mask, forward and backward to the vertices; the least of {REPETITIONS} runs.\n\n\
         | mesh | size | forward | backward | both | DRTK, recorded | against recorded |\n|---|---|---|---|---|---|---|\n{rows}\n\
         Mask gradient to 93 pose parameters against 8×8-supersampled differences: cosine {:.5} (EdgeGrad 0.9996), norm ratio {:.4} \
         (0.998), error {:.2} % (3 %).\n\n\
         Pose refinement by colour and mask, {} steps of Adam, {} random starts {:.0} mm away: {:.1} mm (median; {:.1} to {:.1}). \
         EdgeGrad's recorded run ended at 5.0 mm; its start was not recorded.\n{}",
        MARKS[0],
        q.cosine,
        q.norm_ratio,
        100.0 * q.relative_error,
        refine::STEPS,
        r.end_mm.len(),
        r.start_mm,
        r.median_mm(),
        r.end_mm[0],
        r.end_mm[r.end_mm.len() - 1],
        MARKS[1]
    );
    let text = match (text.find(MARKS[0]), text.find(MARKS[1])) {
        (Some(a), Some(b)) => format!("{}{generated}{}", &text[..a], &text[b + MARKS[1].len()..]),
        _ => format!("{text}\n## Renderer\n\n{generated}\n"),
    };
    std::fs::write(path, text).expect("the table's file can be written");
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
    let mut table = String::new();
    for (size, recorded) in RECORDED_MS {
        for (mesh, rival) in ["2k", "10k", "40k"].into_iter().zip(recorded) {
            let scene = maskgrad::unlit(&data, mesh);
            let camera = scene.camera(size);
            let vertices = scene.posed(&scene.pose(20));
            let light = Light::ambient(1.0);
            let mut rendered = Rendered::default();
            let (mut rgb, mut mask) = (Vec::new(), Vec::new());
            let (mut forward, mut backward) = (f64::INFINITY, f64::INFINITY);
            for _ in 0..REPETITIONS {
                let start = thread_cpu_seconds();
                render_into(&camera, &scene.surface, &vertices, &light, [1.0; 3], &mut rendered);
                let middle = thread_cpu_seconds();
                mean_abs(&rendered, &mut rgb, &mut mask);
                let d = Cotangents { rgb: &rgb, mask: &mask, depth: &[] };
                let gradients = render_vjp(&camera, &scene.surface, &vertices, &light, &rendered, &d, false);
                assert!(gradients.positions.iter().all(|g| g.is_finite()), "gradients are numbers");
                forward = forward.min(1e3 * (middle - start));
                backward = backward.min(1e3 * (thread_cpu_seconds() - middle));
            }
            let both = forward + backward;
            table += &format!(
                "| {mesh} | {size}² | {forward:.2} | {backward:.2} | {both:.2} | {rival} | {:.1}× |\n",
                rival / both
            );
            println!(
                r#"{{"mesh": "{mesh}", "size": {size}, "fwd_ms": {forward:.3}, "bwd_ms": {backward:.3}, "threads": 1}}"#
            );
        }
    }
    let q = maskgrad::quality(&data);
    let r = refine::refinement(&data);
    if let Some(path) = std::env::args().nth(2) {
        write_table(&path, &table, &q, &r);
    }
    println!(
        r#"{{"gradient_cosine": {:.5}, "norm_ratio": {:.4}, "rel_error": {:.4}}}"#,
        q.cosine, q.norm_ratio, q.relative_error
    );
    println!(
        r#"{{"refine_start_mm": {:.1}, "refine_end_mm": {:.1}, "least": {:.1}, "most": {:.1}, "starts": {}}}"#,
        r.start_mm,
        r.median_mm(),
        r.end_mm[0],
        r.end_mm[r.end_mm.len() - 1],
        r.end_mm.len()
    );
}

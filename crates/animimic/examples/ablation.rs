//! What each term of stage 1 is worth: every case is fitted with all terms and with each left out, and measured against truth.
//!
//! `cargo run --release -p animimic --example ablation -- CASE...`, a CASE being a folder of truth with `static.glb`, `video.mp4`,
//! `camera.json` and `gt.npz`. Prints a table of medians over the cases (docs/benchmarks.md), each case's own figures before it.

mod support;

use animimic::{Against, evaluate, truth};
use animimic_fit::stage1::{self, Forgetful, Settings};
use std::error::Error;
use std::ops::ControlFlow;
use std::path::Path;
use support::Case;

/// A name and what it leaves out.
type Variant = (&'static str, fn(&mut Settings));

const VARIANTS: [Variant; 7] = [
    ("all terms", |_| ()),
    ("without rendered colour", |s| s.rgb = 0.0),
    ("without rendered silhouettes", |s| s.mask = 0.0),
    ("without contours and silhouettes", |s| (s.mask, s.contour) = (0.0, 0.0)),
    ("without appearance tracks", |s| s.flow = 0.0),
    ("without smoothness", |s| {
        (s.velocity, s.acceleration) = (1e-3 * s.velocity, 1e-3 * s.acceleration);
        (s.lively_velocity, s.lively_acceleration) = (1e-3 * s.lively_velocity, 1e-3 * s.lively_acceleration);
    }),
    ("without priors on joints", |s| {
        (s.rest, s.off_hinge, s.off_hinge_top, s.lateral, s.limit) = (1e-3 * s.rest, 0.0, 0.0, 0.0, 0.0);
    }),
];

/// Key in the evaluation, and heading.
const FIGURES: [(&str, &str); 6] = [
    ("vertex_rms_pct", "rms %"),
    ("vertex_rms_plane_pct", "in the plane"),
    ("vertex_rms_depth_pct", "in depth"),
    ("iou_main", "IoU"),
    ("iou_novel_m45", "IoU −45°"),
    ("jitter", "jitter"),
];

fn main() -> Result<(), Box<dyn Error>> {
    let cases: Vec<String> = std::env::args().skip(1).collect();
    let mut figures = vec![vec![Vec::new(); FIGURES.len()]; VARIANTS.len()];
    for case in &cases {
        let truth = truth::read(Path::new(case))?;
        let case = Case::read(Path::new(case), usize::MAX)?;
        for ((name, leave_out), row) in VARIANTS.iter().zip(&mut figures) {
            let mut settings = Settings::default();
            leave_out(&mut settings);
            let fps = case.video.fps;
            let outcome =
                stage1::fit(&case.input(), settings, name, fps, &mut Forgetful, &mut |_, _| ControlFlow::Continue(()))?;
            let against = Against { truth: Some(&truth), input: Some(&case.asset), ..Against::default() };
            let evaluation = evaluate(&case.asset, &outcome.motion.poses, fps, &against)?;
            let found: Vec<f64> = FIGURES.iter().map(|f| evaluation.get(f.0).unwrap_or(f64::NAN)).collect();
            println!("{} {name}: {found:.3?}", case.name);
            row.iter_mut().zip(found).for_each(|(all, f)| all.push(f));
        }
    }
    println!("\n| {} cases | {} |", cases.len(), FIGURES.map(|f| f.1).join(" | "));
    println!("|---|{}", "---|".repeat(FIGURES.len()));
    for ((name, _), row) in VARIANTS.iter().zip(&mut figures) {
        let medians: Vec<String> = row.iter_mut().map(|f| format!("{:.3}", median(f))).collect();
        println!("| {name} | {} |", medians.join(" | "));
    }
    Ok(())
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n => 0.5 * (values[(n - 1) / 2] + values[n / 2]),
    }
}

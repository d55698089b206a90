//! The joint problem: 48 frames × 30 joints, 300 noisy tracks and depths, from the rest pose.
//!
//! `cargo bench -p animimic-fit --bench joint_problem`. Reads `../shared/bench/diffrender/data` and skips where that is absent.
//! The energy is that of the reference solver beside the data (Huber 2 px, depth up to scale and shift, smoothness of all
//! vertices, joint limits); the reference reaches 91 974 and 8.97 mm.

mod support;

use animimic_fit::robust::Robust;
use animimic_fit::solver::{Options, Problem, Smoothness, solve};
use animimic_fit::terms::{Context, Depth, DepthTarget, JointPrior, JointPriors, PixelTarget, Pixels};
use animimic_rig::smoothness::pseudo_anchors;
use animimic_rig::{Anchor, AnchorColumns, FramePose, Kinematics};
use animimic_scene::io::npz::{self, Archive};
use animimic_scene::{Camera, DepthKind, Look};
use glam::{DVec2, DVec3};
use std::time::Instant;
use support::cpu_seconds;
use support::quadruped::{Quadruped, anchor, numbers, points};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/bench/diffrender/data");
/// Side of the picture in which the tracks were measured [px].
const SIZE: u32 = 512;
const REPETITIONS: usize = 5;

struct Data {
    kinematics: Kinematics,
    camera: Camera,
    anchors: Vec<Anchor>,
    vertices: Vec<Anchor>,
    pixels: Pixels,
    depth: Depth,
    /// True positions \[frame · vertex\].
    truth: Vec<DVec3>,
    frames: usize,
}

fn main() {
    let folder = std::path::Path::new(DATA);
    if !folder.exists() {
        println!("skipped: {DATA} is absent");
        return;
    }
    let problem = npz::read(folder.join("prob_300.npz")).expect("a readable archive");
    let data = assemble(Quadruped::read(folder, "2k", Look::default()), &problem);
    let mut best = f64::INFINITY;
    for _ in 0..REPETITIONS {
        let (cpu, wall) = (cpu_seconds(), Instant::now());
        let (poses, energies) = run(&data);
        let spent = cpu_seconds() - cpu;
        best = best.min(spent);
        println!(
            "energy {:.1}  vertex error {:.3} mm  iterations {}  CPU {spent:.2} s  wall {:.2} s",
            energies[energies.len() - 1],
            1e3 * vertex_error(&data, &poses),
            energies.len() - 1,
            wall.elapsed().as_secs_f64()
        );
    }
    println!("least CPU time {best:.2} s");
}

/// The whole of it: smoothness structure, solve.
fn run(data: &Data) -> (Vec<FramePose>, Vec<f64>) {
    let smoothness = Smoothness {
        anchors: pseudo_anchors(&data.vertices, data.kinematics.len()),
        velocity: 2e2,
        acceleration: 2e3,
        basis: DVec3::AXES,
    };
    let columns: Vec<AnchorColumns> = data.anchors.iter().map(|a| a.columns(&data.kinematics)).collect();
    let limited = JointPrior { stiffness: 2.0, limit_rad: 1.2, limit_stiffness: 1e2, ..JointPrior::FREE };
    let prior = |p: &Option<usize>| if p.is_some() { limited } else { JointPrior::FREE };
    let priors = JointPriors { joints: vec![data.kinematics.parents.iter().map(prior).collect()] };
    let problem = Problem {
        context: Context {
            kinematics: &data.kinematics,
            camera: &data.camera,
            anchors: &data.anchors,
            columns: &columns,
        },
        terms: vec![&data.pixels, &data.depth, &priors],
        smoothness: Some(&smoothness),
    };
    let mut poses = vec![data.kinematics.rest(); data.frames];
    let report = solve(&problem, &mut poses, 0..data.frames, &Options::default());
    (poses, report.energies)
}

fn vertex_error(data: &Data, poses: &[FramePose]) -> f64 {
    let posed = poses.iter().map(|p| data.kinematics.pose(p));
    let found = posed.flat_map(|p| data.vertices.iter().map(move |v| v.position(&p)).collect::<Vec<_>>());
    found.zip(&data.truth).map(|(a, b)| a.distance(*b)).sum::<f64>() / data.truth.len() as f64
}

fn assemble(scene: Quadruped, problem: &Archive) -> Data {
    let camera = scene.camera(SIZE);
    let Quadruped { kinematics, vertices, .. } = scene;
    let weights = numbers(problem, "anchor_weights");
    let anchors: Vec<Anchor> = points(problem, "anchor_verts")
        .iter()
        .zip(weights.chunks_exact(kinematics.len()))
        .map(|(&x, w)| anchor(x, w.iter().copied().enumerate()))
        .collect();

    let n = anchors.len();
    let (tracks, visible) = (numbers(problem, "tracks"), numbers(problem, "visible"));
    let depths = numbers(problem, "depth");
    let frames = visible.len() / n;
    let seen = |t: usize| (0..n).map(move |i| (i, t * n + i)).filter(|&(_, k)| visible[k] > 0.0);
    let pixel = |(i, k): (usize, usize)| PixelTarget {
        anchor: i as u32,
        pixel: DVec2::new(tracks[2 * k], tracks[2 * k + 1]),
        weight: visible[k],
        normal: None,
    };
    let depth = |(i, k): (usize, usize)| DepthTarget { anchor: i as u32, depth: depths[k], weight: visible[k] };
    let pixels = (0..frames).map(|t| seen(t).map(pixel).collect()).collect();
    let targets = (0..frames).map(|t| seen(t).map(depth).collect()).collect();
    Data {
        kinematics,
        camera,
        anchors,
        vertices,
        pixels: Pixels { targets: pixels, robust: Robust::Huber(2.0), weight: 1.0 },
        depth: Depth {
            targets,
            sigma: 0.004,
            robust: Robust::Squared,
            weight: 1.0,
            affine: true,
            kind: DepthKind::Metric,
        },
        truth: points(problem, "truth_verts"),
        frames,
    }
}

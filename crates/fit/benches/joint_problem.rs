//! The joint problem: 48 frames × 30 joints, 300 noisy tracks and depths, from the rest pose.
//!
//! `cargo bench -p animimic-fit --bench joint_problem`. Reads `../shared/bench/diffrender/data` and skips where that is absent.
//! The energy is that of the reference solver beside the data (Huber 2 px, depth up to scale and shift, smoothness of all
//! vertices, joint limits); the reference reaches 91 974 and 8.97 mm.

use animimic_fit::robust::Robust;
use animimic_fit::solver::{Options, Problem, Smoothness, solve};
use animimic_fit::terms::{Context, Depth, DepthTarget, JointPrior, JointPriors, PixelTarget, Pixels};
use animimic_rig::anchor::Share;
use animimic_rig::smoothness::pseudo_anchors;
use animimic_rig::{Anchor, AnchorColumns, FramePose, Kinematics};
use animimic_scene::io::npz::{self, Archive};
use animimic_scene::{Camera, DepthKind};
use glam::{DAffine3, DMat3, DVec2, DVec3};
use std::time::Instant;

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
    let read = |name: &str| npz::read(folder.join(name)).expect("a readable archive");
    let data = assemble(&read("quad_2k.npz"), &read("prob_300.npz"));
    let mut best = f64::INFINITY;
    for _ in 0..REPETITIONS {
        let (cpu, wall) = (cpu_seconds(), Instant::now());
        let (poses, energies) = run(&data);
        let spent = cpu_seconds().zip(cpu).map_or(f64::NAN, |(after, before)| after - before);
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

fn assemble(scene: &Archive, problem: &Archive) -> Data {
    let numbers = |archive: &Archive, name: &str| archive.need(name).expect("a complete archive").to_f64();
    let points = |archive: &Archive, name: &str| -> Vec<DVec3> {
        numbers(archive, name).chunks_exact(3).map(DVec3::from_slice).collect()
    };
    let parents = numbers(scene, "parents");
    let joints = parents.len();
    let parents: Vec<Option<usize>> = parents.iter().map(|&p| (p >= 0.0).then_some(p as usize)).collect();
    let slides = parents.iter().map(Option::is_none).collect();
    let kinematics = Kinematics::new(parents, points(scene, "joints"), vec![true; joints], slides);

    let weights = numbers(problem, "anchor_weights");
    let rest = points(problem, "anchor_verts");
    let anchors: Vec<Anchor> =
        rest.iter().zip(weights.chunks_exact(joints)).map(|(&x, w)| anchor(x, w.iter().copied().enumerate())).collect();
    let (skin_joints, skin_weights) = (numbers(scene, "skin_idx"), numbers(scene, "skin_w"));
    let vertices = points(scene, "verts")
        .iter()
        .enumerate()
        .map(|(v, &x)| anchor(x, (4 * v..4 * v + 4).map(|k| (skin_joints[k] as usize, skin_weights[k]))))
        .collect();

    let rotation = DMat3::from_cols_slice(&numbers(scene, "cam_R")).transpose();
    let shift = DVec3::from_slice(&numbers(scene, "cam_t"));
    let focal = numbers(scene, "focal_over_size")[0] * f64::from(SIZE);
    let middle = 0.5 * f64::from(SIZE);
    let camera = Camera {
        width: SIZE,
        height: SIZE,
        fx: focal,
        fy: focal,
        cx: middle,
        cy: middle,
        view_from_world: DAffine3::from_mat3_translation(rotation, shift),
    };

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

fn anchor(x: DVec3, weights: impl Iterator<Item = (usize, f64)>) -> Anchor {
    let share = |(joint, weight): (usize, f64)| Share { joint, weight, weighted_rest: x * weight };
    let mut shares: Vec<Share> = weights.filter(|(_, w)| *w > 0.0).map(share).collect();
    shares.sort_by_key(|s| s.joint);
    Anchor { shares }
}

/// CPU seconds of this process, all threads; `None` where the system does not tell.
fn cpu_seconds() -> Option<f64> {
    /// Clock ticks a second in `/proc`, fixed by Linux's user interface.
    const TICKS: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let after_name: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = after_name.get(11)?.parse::<f64>().ok()? + after_name.get(12)?.parse::<f64>().ok()?;
    Some(ticks / TICKS)
}

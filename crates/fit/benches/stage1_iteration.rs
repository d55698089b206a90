//! One whole iteration of stage 1's last solve: 48 frames, 512 × 512, 30 joints, 10 144 faces, all terms.
//!
//! `cargo bench -p animimic-fit --bench stage1_iteration`. Reads `../shared/bench/diffrender/data` and skips where that is
//! absent. An iteration draws every frame, forms both rendered losses and their gradient to the joints, linearises 1 200 point targets a
//! frame and the smoothness, and takes a step in the metric of the banded Hessian. Two threads.

mod support;

use animimic_fit::combined::Combined;
use animimic_fit::quasi_newton::Objective;
use animimic_fit::rendered::{MaskLoss, Model, Observed, RgbLoss, Weighted};
use animimic_fit::robust::Robust;
use animimic_fit::solver::{Problem, Smoothness, linearize};
use animimic_fit::terms::{Context, JointPrior, JointPriors, PixelTarget, Pixels};
use animimic_render::{Light, NONE, rasterize_surface, shade};
use animimic_rig::smoothness::pseudo_anchors;
use animimic_rig::{Anchor, AnchorColumns, FramePose, Kinematics, Posed};
use animimic_scene::{Camera, Image, Look};
use glam::DVec3;
use std::path::Path;
use std::time::Instant;
use support::cpu_seconds;
use support::quadruped::Quadruped;

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/bench/diffrender/data");
const SIZE: u32 = 512;
const THREADS: usize = 2;
const STEPS: usize = 6;
/// Point targets a frame.
const TARGETS: usize = 1200;

fn main() {
    let folder = Path::new(DATA);
    if !folder.exists() {
        println!("skipped: {DATA} is absent");
        return;
    }
    let scene = Quadruped::read(folder, "10k", Look { double_sided: true, ..Look::default() });
    let pool = rayon::ThreadPoolBuilder::new().num_threads(THREADS).build().expect("a pool");
    pool.install(|| run(&scene));
}

fn run(scene: &Quadruped) {
    let camera = scene.camera(SIZE);
    let truth: Vec<FramePose> = (0..scene.frames()).map(|t| scene.pose(t)).collect();
    let light = Light::ambient(1.0);
    let background = Image::filled(SIZE as usize, SIZE as usize, [240; 3]);
    let drawn: Vec<(Image, animimic_render::Raster)> = truth.iter().map(|p| draw(scene, &camera, p, &light)).collect();
    let observed: Vec<Observed> = drawn
        .iter()
        .map(|(image, raster)| {
            let mask = raster.mask();
            Observed { image, background: &background, divisor_px: mask.area() as f64, mask }
        })
        .collect();
    let anchors: Vec<Anchor> =
        (0..TARGETS).map(|k| scene.vertices[k * scene.vertices.len() / TARGETS].clone()).collect();
    let columns: Vec<AnchorColumns> = anchors.iter().map(|a| a.columns(&scene.kinematics)).collect();
    let target = |posed: &Posed| -> Vec<PixelTarget> {
        let place = |(k, a): (usize, &Anchor)| {
            let pixel = camera.project(a.position(posed));
            PixelTarget { anchor: k as u32, pixel, weight: 1.0 / TARGETS as f64, normal: None }
        };
        anchors.iter().enumerate().map(place).collect()
    };
    let posed = |poses: &[FramePose]| -> Vec<Posed> { poses.iter().map(|p| scene.kinematics.pose(p)).collect() };
    let targets = posed(&truth).iter().map(target).collect();
    let points = Pixels { targets, robust: Robust::Huber(0.5), weight: 300.0 };
    let prior = JointPrior { stiffness: 1.0, ..JointPrior::FREE };
    let priors = JointPriors { joints: vec![vec![prior; scene.kinematics.len()]] };
    let smoothness = Smoothness {
        anchors: pseudo_anchors(&scene.vertices, scene.kinematics.len()),
        velocity: 300.0,
        acceleration: 1000.0,
        basis: DVec3::AXES,
    };
    let context = Context { kinematics: &scene.kinematics, camera: &camera, anchors: &anchors, columns: &columns };
    let problem = Problem { context, terms: vec![&points, &priors], smoothness: Some(&smoothness) };
    let start: Vec<FramePose> = truth.iter().enumerate().map(|(t, p)| disturbed(&scene.kinematics, p, t)).collect();
    let metric = linearize(&problem, &start, &posed(&start), &(0..start.len())).factor(1e-2).expect("damped");
    let (rgb, mask) = (RgbLoss::default(), MaskLoss::default());
    let losses = [Weighted { loss: &rgb, weight: 5000.0 }, Weighted { loss: &mask, weight: 5000.0 }];
    let lights = vec![light; start.len()];
    let model =
        Model { kinematics: &scene.kinematics, vertices: &scene.vertices, surface: &scene.surface, camera: &camera };
    let combined = Combined {
        problem: &problem,
        model,
        flesh: None,
        losses: &losses,
        observed: &observed,
        lights: &lights,
        metric,
    };
    let mut poses = start;
    for _ in 0..STEPS {
        let (cpu, wall) = (cpu_seconds(), Instant::now());
        let here = combined.evaluate(&poses);
        let step: Vec<f64> = combined.precondition(&here.gradient).iter().map(|v| -0.1 * v).collect();
        poses = combined.retract(&poses, &step);
        println!(
            "energy {:.1}  an iteration: wall {:.2} s, CPU {:.2} s, {THREADS} threads",
            here.parts.iter().sum::<f64>(),
            wall.elapsed().as_secs_f64(),
            cpu_seconds() - cpu
        );
    }
    let cpu = cpu_seconds();
    for _ in 0..4 {
        let all = poses.iter().zip(&observed).map(|(p, seen)| model.evaluate(&losses, seen, &light, p, true));
        assert!(all.count() == poses.len());
    }
    let rendered = (cpu_seconds() - cpu) / 4.0;
    let cpu = cpu_seconds();
    for _ in 0..4 {
        assert!(linearize(&problem, &poses, &posed(&poses), &(0..poses.len())).gradient[0].is_finite());
    }
    println!("of that, rendering {rendered:.2} CPU s, linearising {:.2} CPU s", (cpu_seconds() - cpu) / 4.0);
}

/// A picture of the quadruped in a pose.
fn draw(scene: &Quadruped, camera: &Camera, pose: &FramePose, light: &Light) -> (Image, animimic_render::Raster) {
    let positions = scene.posed(pose);
    let raster = rasterize_surface(camera, &scene.surface, &positions, true);
    let behind = 240.0 / 255.0;
    let rgb = shade(camera, &scene.surface, &positions, &raster, light, [behind; 3], true);
    let image = Image {
        width: SIZE as usize,
        height: SIZE as usize,
        rgb: rgb.iter().map(|c| c.map(|v| (255.0 * v + 0.5) as u8)).collect(),
    };
    let covered = raster.triangle.iter().filter(|&&t| t != NONE).count();
    assert!(covered > 1000, "the model is in the picture");
    (image, raster)
}

fn disturbed(kinematics: &Kinematics, pose: &FramePose, t: usize) -> FramePose {
    let step = |i: usize| 0.01 * (1.3 * i as f64 + 0.2 * t as f64).sin();
    kinematics.retract(pose, &(0..kinematics.dimension).map(step).collect::<Vec<_>>())
}

//! One whole iteration of stage 1's last solve: 48 frames, 512 × 512, 30 joints, 10 144 faces, all terms.
//!
//! `cargo bench -p animimic-fit --bench stage1_iteration`. Reads `../shared/bench/diffrender/data/quad_10k.npz` and skips where that is
//! absent. An iteration draws every frame, forms both rendered losses and their gradient to the joints, linearises 1 200 point targets a
//! frame and the smoothness, and takes a step in the metric of the banded Hessian. Two threads.

use animimic_fit::combined::Combined;
use animimic_fit::quasi_newton::Objective;
use animimic_fit::rendered::{MaskLoss, Model, Observed, RgbLoss, Weighted};
use animimic_fit::robust::Robust;
use animimic_fit::solver::{Problem, Smoothness, linearize};
use animimic_fit::terms::{Context, JointPrior, JointPriors, PixelTarget, Pixels};
use animimic_math::so3;
use animimic_render::{Light, NONE, Surface, rasterize_surface, shade};
use animimic_rig::anchor::Share;
use animimic_rig::smoothness::pseudo_anchors;
use animimic_rig::{Anchor, AnchorColumns, FramePose, Kinematics, Posed};
use animimic_scene::io::npz::{self, Archive};
use animimic_scene::{Camera, Image, Look, Mesh, Part};
use glam::{DAffine3, DMat3, DVec3};
use std::time::Instant;

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/bench/diffrender/data/quad_10k.npz");
const SIZE: u32 = 512;
const THREADS: usize = 2;
const STEPS: usize = 6;
/// Point targets a frame.
const TARGETS: usize = 1200;

struct Scene {
    kinematics: Kinematics,
    vertices: Vec<Anchor>,
    surface: Surface,
    camera: Camera,
    truth: Vec<FramePose>,
}

fn main() {
    if !std::path::Path::new(DATA).exists() {
        println!("skipped: {DATA} is absent");
        return;
    }
    let scene = Scene::new(&npz::read(DATA).expect("a readable archive"));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(THREADS).build().expect("a pool");
    pool.install(|| run(&scene));
}

fn run(scene: &Scene) {
    let light = Light::ambient(1.0);
    let background = Image::filled(SIZE as usize, SIZE as usize, [240; 3]);
    let drawn: Vec<(Image, animimic_render::Raster)> = scene.truth.iter().map(|p| scene.draw(p, &light)).collect();
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
            let pixel = scene.camera.project(a.position(posed));
            PixelTarget { anchor: k as u32, pixel, weight: 1.0 / TARGETS as f64, normal: None }
        };
        anchors.iter().enumerate().map(place).collect()
    };
    let posed = |poses: &[FramePose]| -> Vec<Posed> { poses.iter().map(|p| scene.kinematics.pose(p)).collect() };
    let targets = posed(&scene.truth).iter().map(target).collect();
    let points = Pixels { targets, robust: Robust::Huber(0.5), weight: 300.0 };
    let prior = JointPrior { stiffness: 1.0, ..JointPrior::FREE };
    let priors = JointPriors { joints: vec![vec![prior; scene.kinematics.len()]] };
    let smoothness = Smoothness {
        anchors: pseudo_anchors(&scene.vertices, scene.kinematics.len()),
        velocity: 300.0,
        acceleration: 1000.0,
        basis: DVec3::AXES,
    };
    let context =
        Context { kinematics: &scene.kinematics, camera: &scene.camera, anchors: &anchors, columns: &columns };
    let problem = Problem { context, terms: vec![&points, &priors], smoothness: Some(&smoothness) };
    let start: Vec<FramePose> = scene.truth.iter().enumerate().map(|(t, p)| scene.disturbed(p, t)).collect();
    let metric = linearize(&problem, &start, &posed(&start), &(0..start.len())).factor(1e-2).expect("damped");
    let (rgb, mask) = (RgbLoss::default(), MaskLoss::default());
    let losses = [Weighted { loss: &rgb, weight: 5000.0 }, Weighted { loss: &mask, weight: 5000.0 }];
    let lights = vec![light; start.len()];
    let model = Model {
        kinematics: &scene.kinematics,
        vertices: &scene.vertices,
        surface: &scene.surface,
        camera: &scene.camera,
    };
    let combined = Combined { problem: &problem, model, losses: &losses, observed: &observed, lights: &lights, metric };
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

impl Scene {
    fn new(archive: &Archive) -> Self {
        let numbers = |name: &str| archive.get(name).expect("the array is in the archive").to_f64();
        let points = |name: &str| -> Vec<DVec3> { numbers(name).chunks_exact(3).map(DVec3::from_slice).collect() };
        let parents: Vec<Option<usize>> =
            numbers("parents").iter().map(|&p| (p >= 0.0).then_some(p as usize)).collect();
        let joints = parents.len();
        let slides = parents.iter().map(Option::is_none).collect();
        let kinematics = Kinematics::new(parents, points("joints"), vec![true; joints], slides);
        let positions = points("verts");
        let (skin_joints, skin_weights) = (numbers("skin_idx"), numbers("skin_w"));
        let anchor = |(v, &x): (usize, &DVec3)| {
            let shares = (4 * v..4 * v + 4).filter(|&k| skin_weights[k] > 0.0).map(|k| Share {
                joint: skin_joints[k] as usize,
                weight: skin_weights[k],
                weighted_rest: x * skin_weights[k],
            });
            Anchor { shares: shares.collect() }
        };
        let vertices = positions.iter().enumerate().map(anchor).collect();
        let corners: Vec<u32> = numbers("faces").iter().map(|&v| v as u32).collect();
        let mesh = Mesh {
            triangles: corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
            colors: points("colors").iter().map(|c| c.to_array().map(|v| v as f32)).collect(),
            parts: vec![Part { vertices: 0..positions.len(), triangles: 0..corners.len() / 3, ..Part::default() }],
            positions,
            ..Mesh::default()
        };
        let looks = [Look { double_sided: true, ..Look::default() }];
        let surface = Surface::new(&mesh, &looks).expect("the bench's mesh is sound");
        let turns = points("aa");
        let shifts = points("trans");
        let pose = |t: usize| {
            let mut pose = kinematics.rest();
            (0..joints).for_each(|j| pose.rotations[j] = so3::exp(turns[t * joints + j]));
            pose.displacements[0] = shifts[t];
            pose
        };
        let truth = (0..shifts.len()).map(pose).collect();
        let focal = numbers("focal_over_size")[0] * f64::from(SIZE);
        let rotation = DMat3::from_cols_slice(&numbers("cam_R")).transpose();
        let view_from_world = DAffine3::from_mat3_translation(rotation, DVec3::from_slice(&numbers("cam_t")));
        let middle = 0.5 * f64::from(SIZE);
        let camera =
            Camera { width: SIZE, height: SIZE, fx: focal, fy: focal, cx: middle, cy: middle, view_from_world };
        Self { kinematics, vertices, surface, camera, truth }
    }

    fn draw(&self, pose: &FramePose, light: &Light) -> (Image, animimic_render::Raster) {
        let posed = self.kinematics.pose(pose);
        let positions: Vec<DVec3> = self.vertices.iter().map(|a| a.position(&posed)).collect();
        let raster = rasterize_surface(&self.camera, &self.surface, &positions, true);
        let behind = 240.0 / 255.0;
        let rgb = shade(&self.camera, &self.surface, &positions, &raster, light, [behind; 3], true);
        let image = Image {
            width: SIZE as usize,
            height: SIZE as usize,
            rgb: rgb.iter().map(|c| c.map(|v| (255.0 * v + 0.5) as u8)).collect(),
        };
        let covered = raster.triangle.iter().filter(|&&t| t != NONE).count();
        assert!(covered > 1000, "the model is in the picture");
        (image, raster)
    }

    fn disturbed(&self, pose: &FramePose, t: usize) -> FramePose {
        let step = |i: usize| 0.01 * (1.3 * i as f64 + 0.2 * t as f64).sin();
        self.kinematics.retract(pose, &(0..self.kinematics.dimension).map(step).collect::<Vec<_>>())
    }
}

/// CPU seconds of this process, all threads; not a number where the system does not tell.
fn cpu_seconds() -> f64 {
    /// Clock ticks a second in `/proc`, fixed by Linux's user interface.
    const TICKS: f64 = 100.0;
    let read = || -> Option<f64> {
        let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
        let after_name: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
        Some((after_name.get(11)?.parse::<f64>().ok()? + after_name.get(12)?.parse::<f64>().ok()?) / TICKS)
    };
    read().unwrap_or(f64::NAN)
}

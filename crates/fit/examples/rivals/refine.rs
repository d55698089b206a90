//! Pose refinement from one picture: from a disturbed pose back to the recorded one by colour and mask alone.
//!
//! The rivals' test names the error at the start (68 mm), at the end (5.0 mm) and the number of steps (120 of Adam), not the start
//! itself. Here starts are random: every joint turned about a random axis, the root moved, all in one proportion that makes the
//! mean distance of the vertices 68 mm. The result is a distribution.

use crate::maskgrad::unlit;
use crate::support::quadruped::{Quadruped, tree_order};
use animimic_fit::reference::Adam;
use animimic_math::gradcheck::SplitMix64;
use animimic_render::{Background, Cotangents, Light, Rendered, render_image, render_into, render_vjp};
use animimic_rig::FramePose;
use animimic_scene::io::npz;
use glam::DVec3;
use std::path::Path;

/// Mean vertex distance at the start [m].
const START: f64 = 0.068;
/// Steps of Adam.
pub const STEPS: usize = 120;
/// Number of random starts.
const STARTS: u64 = 12;
/// Adam's step size [rad or m].
const RATE: f64 = 5e-3;
/// Residuals above it count by size, smaller ones by square: parts that are elsewhere decide less.
const SOFT: f32 = 0.1;

/// Mean vertex distances [mm]: at the start, then at the end of every run, sorted.
pub struct Refinement {
    /// At the start.
    pub start_mm: f64,
    /// At the ends.
    pub end_mm: Vec<f64>,
}

impl Refinement {
    /// Median of the ends [mm].
    pub fn median_mm(&self) -> f64 {
        self.end_mm[self.end_mm.len() / 2]
    }
}

/// Runs all starts.
pub fn refinement(data: &Path) -> Refinement {
    let file = npz::read(data.join("maskgrad.npz")).expect("the benchmark's gradient test is readable");
    let number = |name: &str| file.need(name).expect("the benchmark's file has this array").to_f64()[0] as usize;
    let scene = unlit(data, "2k");
    let truth = scene.pose(number("target_frame"));
    let view = View::new(&scene, &truth, number("size") as u32);
    let mut end_mm: Vec<f64> =
        (0..STARTS).map(|seed| 1e3 * view.distance(&view.refined(disturbed(&view, &truth, seed)))).collect();
    end_mm.sort_by(f64::total_cmp);
    Refinement { start_mm: 1e3 * START, end_mm }
}

/// What is seen and from where.
struct View<'a> {
    scene: &'a Quadruped,
    camera: animimic_scene::Camera,
    light: Light,
    truth: Vec<DVec3>,
    rgb: Vec<[f32; 3]>,
    mask: Vec<f32>,
}

impl<'a> View<'a> {
    fn new(scene: &'a Quadruped, truth: &FramePose, size: u32) -> Self {
        let (camera, light, truth) = (scene.camera(size), Light::ambient(1.0), scene.posed(truth));
        let (image, mask) = render_image(&camera, &scene.surface, &truth, &light, Background::Color([255; 3]), 8);
        let rgb = image.rgb.iter().map(|p| p.map(|c| f32::from(c) / 255.0)).collect();
        let mask = mask.coverage.iter().map(|&c| f32::from(c) / 255.0).collect();
        Self { scene, camera, light, truth, rgb, mask }
    }

    /// Mean distance of a pose's vertices from the true ones [m].
    fn distance(&self, pose: &FramePose) -> f64 {
        let vertices = self.scene.posed(pose);
        vertices.iter().zip(&self.truth).map(|(a, b)| a.distance(*b)).sum::<f64>() / vertices.len() as f64
    }

    /// Σ ρ(rgb − target) + ρ(mask − target), ρ' = [`slope`]: its gradient to the pose's 93 increments.
    fn gradient(&self, pose: &FramePose, rendered: &mut Rendered) -> Vec<f64> {
        let vertices = self.scene.posed(pose);
        render_into(&self.camera, &self.scene.surface, &vertices, &self.light, [1.0; 3], rendered);
        let rgb: Vec<[f32; 3]> =
            rendered.rgb.iter().zip(&self.rgb).map(|(a, b)| std::array::from_fn(|c| slope(a[c] - b[c]))).collect();
        let covered = |p: usize| f32::from(u8::from(rendered.raster.covered(p)));
        let mask: Vec<f32> = self.mask.iter().enumerate().map(|(p, b)| slope(covered(p) - b)).collect();
        let d = Cotangents { rgb: &rgb, mask: &mask, depth: &[] };
        let g = render_vjp(&self.camera, &self.scene.surface, &vertices, &self.light, rendered, &d, false);
        self.scene.pose_vjp(pose, &g.positions)
    }

    /// Adam on rotation increments and the root's offset.
    fn refined(&self, mut pose: FramePose) -> FramePose {
        let mut rendered = Rendered::default();
        let mut adam = Adam::new(self.scene.kinematics.dimension);
        for _ in 0..STEPS {
            let step = adam.direction(&self.gradient(&pose, &mut rendered));
            pose = self.moved(&pose, &step, -RATE);
        }
        pose
    }

    fn moved(&self, pose: &FramePose, step: &[f64], share: f64) -> FramePose {
        self.scene.kinematics.retract(pose, &step.iter().map(|v| share * v).collect::<Vec<_>>())
    }
}

/// Slope of ρ(e) = √(e² + s²), s = [`SOFT`].
fn slope(e: f32) -> f32 {
    e / (e * e + SOFT * SOFT).sqrt()
}

/// The true pose with a random error of the right size.
fn disturbed(view: &View, truth: &FramePose, seed: u64) -> FramePose {
    let mut rng = SplitMix64(seed);
    // A radian at the joints goes with half a metre at the root.
    let n = 3 * truth.rotations.len();
    let change: Vec<f64> = (0..n + 3).map(|k| rng.normal() * if k < n { 1.0 } else { 0.5 }).collect();
    let change = tree_order(&change);
    let (mut least, mut most) = (0.0, 0.5);
    for _ in 0..40 {
        let middle = 0.5 * (least + most);
        let low = view.distance(&view.moved(truth, &change, middle)) < START;
        *(if low { &mut least } else { &mut most }) = middle;
    }
    view.moved(truth, &change, least)
}

//! The total loss L of the reference, which scores any motion.
//!
//! L = 0.5 rgb + 1 mask + 3 track + 0.3 depth + 0.3 smooth₁ + 1.0 smooth₂ + 1 reg. Means over frames; rgb and mask are means over
//! the picture of our rendered losses; tracks are measured in half picture heights, lengths in half the model's longest side,
//! as the reference scales its models to \[−1, 1\].

use crate::rendered::{MaskLoss, Model, Observed, RgbLoss, Weighted};
use crate::stage1::Input;
use crate::stage1::correspond::Correspondences;
use crate::stage1::given::Given;
use crate::stage1::sight::{Sight, Studio};
use crate::stage1::subject::Subject;
use crate::terms::{reading, slope};
use crate::view::project;
use animimic_math::so3;
use animimic_render::Light;
use animimic_rig::{FramePose, Kinematics, Posed, pose_vjp};
use animimic_scene::{Camera, DepthKind};
use glam::DVec3;
use rayon::prelude::*;

const RGB: f64 = 0.5;
const MASK: f64 = 1.0;
/// Weight of the tracks.
pub const TRACK: f64 = 3.0;
const DEPTH: f64 = 0.3;
/// Weights of first and second differences of vertices.
pub const SMOOTH: [f64; 2] = [0.3, 1.0];
/// Weight of the regularity of joints.
pub const REG: f64 = 1.0;
/// Weight of a translation against an angle, both squared.
pub const TRANSLATION: f64 = 100.0;
/// Angle from rest beyond which a joint is pulled back [rad].
pub const LIMIT_RAD: f64 = std::f64::consts::PI / 10.0;
/// Depth is compared where a track is at least this sure.
const SURE: f64 = 0.45;
/// Quantiles between which depth is spread.
const QUANTILES: [f64; 2] = [0.05, 0.95];

/// The parts of L, each with its weight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Parts {
    /// Colour.
    pub rgb: f64,
    /// Silhouette.
    pub mask: f64,
    /// Point tracks.
    pub track: f64,
    /// Depth at the tracks.
    pub depth: f64,
    /// First and second differences of vertices.
    pub smooth: f64,
    /// Angles and translations of joints.
    pub reg: f64,
}

impl Parts {
    /// L.
    pub fn total(&self) -> f64 {
        self.rgb + self.mask + self.track + self.depth + self.smooth + self.reg
    }

    /// Parts with their names.
    pub fn named(&self) -> [(&'static str, f64); 6] {
        let names = ["rgb", "mask", "track", "depth", "smooth", "reg"];
        let values = [self.rgb, self.mask, self.track, self.depth, self.smooth, self.reg];
        std::array::from_fn(|k| (names[k], values[k]))
    }

    fn add(&mut self, other: &Parts, scale: f64) {
        self.rgb += scale * other.rgb;
        self.mask += scale * other.mask;
        self.track += scale * other.track;
        self.depth += scale * other.depth;
        self.smooth += scale * other.smooth;
        self.reg += scale * other.reg;
    }
}

/// L with everything that it compares with.
pub struct Loss<'a> {
    model: Model<'a>,
    light: &'a Light,
    observed: Vec<Observed<'a>>,
    targets: Vec<Correspondences>,
    kind: DepthKind,
    /// Half the longest side of the model at rest [model unit].
    unit: f64,
}

impl<'a> Loss<'a> {
    /// Gathers what a video shows of a model; `kinematics` is the subject's tree or [`super::free`]'s.
    pub fn new(input: &Input<'a>, subject: &'a Subject, kinematics: &'a Kinematics, light: &'a Light) -> Self {
        let studio = Studio { camera: input.camera, light };
        let background = |t: usize| &input.backgrounds[t.min(input.backgrounds.len() - 1)];
        let first = Sight::draw(subject, &studio, background(0), &subject.tree.kinematics.rest());
        let given = Given::new(input.tracks, input.depth, input.depth_kind, subject, input.camera, &first);
        let targets = (0..input.frames.len())
            .map(|t| {
                let mut found = Correspondences::default();
                given.add_tracks(subject, t, &mut found);
                given.add_depth(input.camera, t, &mut found);
                found.depth.retain(|d| d.weight > SURE);
                found
            })
            .collect();
        let observed = (0..input.frames.len())
            .map(|t| Observed {
                image: &input.frames[t],
                background: background(t),
                mask: input.masks[t].clone(),
                divisor_px: (input.frames[t].width * input.frames[t].height) as f64,
            })
            .collect();
        let (low, high) = input.asset.mesh.bounds();
        let vertices = &subject.vertices;
        Self {
            model: Model { kinematics, vertices, surface: &subject.surface, camera: input.camera },
            light,
            observed,
            targets,
            kind: input.depth_kind,
            unit: 0.5 * (high - low).max_element(),
        }
    }

    /// The tree in which gradients are given.
    pub fn kinematics(&self) -> &'a Kinematics {
        self.model.kinematics
    }

    /// L of a motion.
    pub fn score(&self, poses: &[FramePose]) -> Parts {
        self.evaluate(poses, false).0
    }

    /// L and its gradient, as increments \[frame\]\[parameter\].
    pub fn with_gradient(&self, poses: &[FramePose]) -> (Parts, Vec<Vec<f64>>) {
        self.evaluate(poses, true)
    }

    fn evaluate(&self, poses: &[FramePose], gradient: bool) -> (Parts, Vec<Vec<f64>>) {
        let n = poses.len();
        let frames: Vec<(Parts, Vec<f64>)> =
            (0..n).into_par_iter().map(|t| self.frame(t, &poses[t], LIMIT_RAD, gradient)).collect();
        let mut parts = Parts::default();
        frames.iter().for_each(|(p, _)| parts.add(p, 1.0 / n as f64));
        let posed: Vec<Posed> = poses.par_iter().map(|p| self.model.kinematics.pose(p)).collect();
        let positions: Vec<Vec<DVec3>> =
            posed.par_iter().map(|posed| self.model.vertices.iter().map(|a| a.position(posed)).collect()).collect();
        let (smooth, forces) = smoothness(&positions, self.unit);
        parts.smooth = smooth;
        if !gradient {
            return (parts, Vec::new());
        }
        let gradients = frames
            .into_par_iter()
            .enumerate()
            .map(|(t, (_, own))| {
                let bending = pose_vjp(self.model.kinematics, &posed[t], self.model.vertices, &forces[t]);
                own.iter().zip(bending).map(|(a, b)| a / n as f64 + b).collect()
            })
            .collect();
        (parts, gradients)
    }

    /// L of one frame by itself, without smoothness, and its gradient if asked for.
    pub fn frame(&self, t: usize, pose: &FramePose, limit_rad: f64, gradient: bool) -> (Parts, Vec<f64>) {
        let (rgb, mask) = (RgbLoss::default(), MaskLoss::default());
        let losses = [Weighted { loss: &rgb, weight: RGB }, Weighted { loss: &mask, weight: MASK }];
        let rendered = self.model.evaluate(&losses, &self.observed[t], self.light, pose, gradient);
        let posed = self.model.kinematics.pose(pose);
        let targets = &self.targets[t];
        let mut forces = vec![DVec3::ZERO; targets.anchors.len()];
        let mut parts = Parts {
            rgb: RGB * rendered.losses[0],
            mask: MASK * rendered.losses[1],
            track: self.track(targets, &posed, &mut forces),
            depth: self.depth(targets, &posed, &mut forces),
            ..Parts::default()
        };
        let mut sum = rendered.gradient;
        sum.resize(self.model.kinematics.dimension, 0.0);
        parts.reg = self.regularity(pose, limit_rad, &mut sum);
        if !gradient {
            return (parts, Vec::new());
        }
        let pulled = pose_vjp(self.model.kinematics, &posed, &targets.anchors, &forces);
        sum.iter_mut().zip(pulled).for_each(|(a, b)| *a += b);
        (parts, sum)
    }

    /// Mean L1 distance between points and their tracks, weighted by confidence.
    fn track(&self, targets: &Correspondences, posed: &Posed, forces: &mut [DVec3]) -> f64 {
        let camera: &Camera = self.model.camera;
        let total: f64 = targets.tracks.iter().map(|t| t.weight).sum::<f64>().max(1e-9);
        let scale = TRACK / (total * 0.5 * f64::from(camera.height));
        let mut sum = 0.0;
        for t in &targets.tracks {
            let seen = project(camera, targets.anchors[t.anchor as usize].position(posed));
            let r = seen.pixel - t.pixel;
            sum += t.weight * (r.x.abs() + r.y.abs());
            forces[t.anchor as usize] += (seen.du * r.x.signum() + seen.dv * r.y.signum()) * (t.weight * scale);
        }
        sum * scale
    }

    /// Mean L1 distance between depths, each less its median and over the spread of its quantiles.
    fn depth(&self, targets: &Correspondences, posed: &Posed, forces: &mut [DVec3]) -> f64 {
        if targets.depth.len() < 2 {
            return 0.0;
        }
        let camera = self.model.camera;
        let place = |a: u32| camera.to_view(targets.anchors[a as usize].position(posed)).z;
        let ours: Vec<f64> = targets.depth.iter().map(|d| reading(self.kind, place(d.anchor))).collect();
        let seen: Vec<f64> = targets.depth.iter().map(|d| d.depth).collect();
        let (value, slopes) = spread_l1(&ours, &seen);
        let axis = camera.view_from_world.matrix3.row(2);
        for ((d, ours), s) in targets.depth.iter().zip(&ours).zip(slopes) {
            forces[d.anchor as usize] += axis * (DEPTH * s * slope(self.kind, *ours));
        }
        DEPTH * value
    }

    /// Mean over joints but the roots of the squared angle beyond the limit and the squared translation.
    fn regularity(&self, pose: &FramePose, limit_rad: f64, gradient: &mut [f64]) -> f64 {
        let k = self.model.kinematics;
        let joints: Vec<usize> = (0..k.len()).filter(|&j| k.parents[j].is_some() && k.turns[j]).collect();
        let scale = REG / joints.len().max(1) as f64;
        let mut sum = 0.0;
        for j in joints {
            let w = so3::log(&pose.rotations[j]);
            let beyond = (w.length() - limit_rad).max(0.0);
            let shift = pose.displacements[j] / self.unit;
            sum += beyond * beyond + TRANSLATION * shift.length_squared();
            if let Some(o) = k.turn_offset[j].filter(|_| beyond > 0.0) {
                let d = w.normalize() * (2.0 * scale * beyond);
                gradient[o..o + 3].iter_mut().zip(d.to_array()).for_each(|(a, b)| *a += b);
            }
            if let Some(o) = k.slide_offset[j] {
                let d = shift * (2.0 * scale * TRANSLATION / self.unit);
                gradient[o..o + 3].iter_mut().zip(d.to_array()).for_each(|(a, b)| *a += b);
            }
        }
        scale * sum
    }
}

/// Mean L1 between two lists, each less its median and divided by the spread of its quantiles, and the derivative with respect to
/// the first, statistics included.
fn spread_l1(ours: &[f64], seen: &[f64]) -> (f64, Vec<f64>) {
    let normal = |values: &[f64]| {
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        let at = |q: f64| order[(q * (values.len() - 1) as f64).round() as usize];
        let (middle, low, high) = (at(0.5), at(QUANTILES[0]), at(QUANTILES[1]));
        (middle, low, high, (values[high] - values[low]).max(1e-9))
    };
    let (middle, low, high, spread) = normal(ours);
    let (seen_middle, _, _, seen_spread) = normal(seen);
    let n = ours.len() as f64;
    let mut slopes = vec![0.0; ours.len()];
    let (mut value, mut all, mut stretch) = (0.0, 0.0, 0.0);
    for i in 0..ours.len() {
        let z = (ours[i] - ours[middle]) / spread;
        let r = z - (seen[i] - seen[seen_middle]) / seen_spread;
        value += r.abs() / n;
        let s = r.signum() / (n * spread);
        slopes[i] += s;
        all += s;
        stretch += s * z;
    }
    slopes[middle] -= all;
    slopes[high] -= stretch;
    slopes[low] += stretch;
    (value, slopes)
}

/// Weighted mean L1 of first and second differences over vertices and frames, in units of `unit`, and the forces on all vertices.
fn smoothness(positions: &[Vec<DVec3>], unit: f64) -> (f64, Vec<Vec<DVec3>>) {
    let mut forces: Vec<Vec<DVec3>> = positions.iter().map(|x| vec![DVec3::ZERO; x.len()]).collect();
    let mut value = 0.0;
    for (stencil, weight) in [[-1.0, 1.0].as_slice(), [1.0, -2.0, 1.0].as_slice()].into_iter().zip(SMOOTH) {
        let Some(last) = (positions.len() + 1).checked_sub(stencil.len()).filter(|&l| l > 0) else { continue };
        let scale = weight / (unit * (last * positions[0].len()) as f64);
        for t in 0..last {
            for v in 0..positions[0].len() {
                let d: DVec3 = stencil.iter().enumerate().map(|(i, c)| positions[t + i][v] * *c).sum();
                value += scale * (d.x.abs() + d.y.abs() + d.z.abs());
                // A vertex that does not move has no direction.
                let sign = DVec3::select(d.cmpeq(DVec3::ZERO), DVec3::ZERO, d.signum()) * scale;
                stencil.iter().enumerate().for_each(|(i, c)| forces[t + i][v] += sign * *c);
            }
        }
    }
    (value, forces)
}

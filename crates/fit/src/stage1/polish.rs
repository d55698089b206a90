//! The last touch: all terms together with the rendered ones.
//!
//! Correspondences say where points are; colour and silhouette say what is still different. E = (all terms of the last
//! linearisation) + w_rgb L_rgb + w_mask L_mask over all frames, minimised by L-BFGS in the metric of the Levenberg–Marquardt
//! Hessian, which knows how stiff each joint is. Only descent is accepted.

use super::correspond::{Correspondences, Frame};
use super::solve::Stage;
use crate::quasi_newton::{Evaluation, Objective, minimise};
use crate::rendered::{MaskLoss, Model, Observed, RgbLoss, Value, Weighted};
use crate::solver::{Problem, linearize, retract};
use crate::terms::{At, Term};
use animimic_math::block_tridiagonal::Factor;
use animimic_render::{Light, solve_exposure};
use animimic_rig::{FramePose, Posed};
use animimic_scene::Mask;
use rayon::prelude::*;

/// Damping of the metric.
const DAMPING: f64 = 1e-2;
/// A step that gains less than this share of the energy is the last.
const TOLERANCE: f64 = 1e-4;

/// A term's energy after each step.
#[derive(Clone, Debug)]
pub struct Curve {
    /// The term.
    pub name: String,
    /// Energies.
    pub values: Vec<f64>,
}

impl Stage<'_> {
    /// Polishes all frames; returns the energy of each term after each step.
    pub fn polish(&self, poses: &mut Vec<FramePose>) -> Vec<Curve> {
        let s = &self.settings;
        // The strength at which refinement ends.
        let strength = self.strength(0, 1, 1.0);
        if s.polish_steps == 0 || (s.rgb <= 0.0 && s.mask <= 0.0) {
            return Vec::new();
        }
        let count = poses.len();
        let found: Vec<Correspondences> =
            (0..count).into_par_iter().map(|t| self.correspond(&poses[t], t, s.reach_px.1)).collect();
        let lights: Vec<Light> = (0..count).into_par_iter().map(|t| self.exposed(&poses[t], t)).collect();
        let observed: Vec<Observed> = self.frames.par_iter().map(|f| observed(f, self.contour_bias_px)).collect();
        self.with_problem(count, 0..count, &found, strength, |problem| {
            let posed = pose_all(problem, poses);
            let Some(metric) = linearize(problem, poses, &posed, &(0..count)).factor(DAMPING) else {
                return Vec::new();
            };
            let (rgb, mask) = (RgbLoss::default(), MaskLoss::default());
            let losses = [Weighted { loss: &rgb, weight: s.rgb }, Weighted { loss: &mask, weight: s.mask }];
            let polish =
                Polish { problem, model: self.model(), losses: &losses, observed: &observed, lights: &lights, metric };
            let history;
            (*poses, history) = minimise(&polish, std::mem::take(poses), s.polish_steps, TOLERANCE);
            let names = ["flow", "contour", "tracks", "depth", "priors", "penetration", "smoothness", "rgb", "mask"];
            let curve =
                |(k, name): (usize, &str)| Curve { name: name.into(), values: history.iter().map(|h| h[k]).collect() };
            names.into_iter().enumerate().map(curve).collect()
        })
    }

    /// What rendered losses draw.
    pub fn model(&self) -> Model<'_> {
        Model {
            kinematics: &self.subject.tree.kinematics,
            vertices: &self.subject.vertices,
            surface: &self.subject.surface,
            camera: self.studio.camera,
        }
    }

    /// The light with the exposure of a frame.
    fn exposed(&self, pose: &FramePose, t: usize) -> Light {
        let sight = self.draw(pose, t);
        let rgb: Vec<[f32; 3]> = sight.image.rgb.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect();
        let (image, mask) = (self.frames[t].image, self.frames[t].mask);
        let gain = solve_exposure(&rgb, &sight.raster, image, Some(mask)).unwrap_or([1.0; 3]);
        self.studio.light.scaled(gain.map(|g| g.clamp(1.0 / MAX_GAIN, MAX_GAIN)))
    }
}

/// Exposure drifts less than this; more is a wrong pose.
const MAX_GAIN: f64 = 1.25;
/// The mask is shifted where its contour is nearer than this [px].
const BAND_PX: f64 = 4.0;

/// A frame with its mask as a rendering in the right place would have it: the observed contour lies `bias_px` outside.
fn observed<'a>(frame: &Frame<'a>, bias_px: f64) -> Observed<'a> {
    let mut mask = Mask {
        width: frame.mask.width,
        height: frame.mask.height,
        coverage: frame.mask.coverage.iter().map(|&c| if c >= 128 { 255 } else { 0 }).collect(),
    };
    let contour = &frame.contour;
    let reach = BAND_PX as isize + 1;
    let (w, h) = (mask.width as isize, mask.height as isize);
    for point in &contour.points {
        let (x0, y0) = (point.x as isize, point.y as isize);
        for y in (y0 - reach).max(0)..(y0 + reach + 1).min(h) {
            for x in (x0 - reach).max(0)..(x0 + reach + 1).min(w) {
                let p = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let Some(q) = contour.nearest(p).filter(|&q| contour.points[q].distance(p) < BAND_PX) else { continue };
                // Boundary pixels are inside; their edge is half a pixel farther out.
                let depth = contour.normals[q].dot(contour.points[q] - p) + 0.5 - bias_px;
                mask.coverage[(y * w + x) as usize] = (255.0 * (depth + 0.5).clamp(0.0, 1.0)) as u8;
            }
        }
    }
    let area: f64 = mask.coverage.iter().map(|&c| f64::from(c) / 255.0).sum();
    Observed { image: frame.image, background: frame.background, divisor_px: area.max(LEAST_AREA_PX), mask }
}

/// An object smaller than this does not count more for being small [px].
const LEAST_AREA_PX: f64 = 400.0;

fn pose_all(problem: &Problem, poses: &[FramePose]) -> Vec<Posed> {
    poses.iter().map(|p| problem.context.kinematics.pose(p)).collect()
}

/// The sum of all terms over all frames.
struct Polish<'a> {
    problem: &'a Problem<'a>,
    model: Model<'a>,
    losses: &'a [Weighted<'a>],
    observed: &'a [Observed<'a>],
    lights: &'a [Light],
    metric: Factor,
}

impl Objective for Polish<'_> {
    type Point = Vec<FramePose>;

    /// Parts: the terms of the linearised problem in their order, smoothness, the rendered losses in theirs.
    fn evaluate(&self, poses: &Vec<FramePose>) -> Evaluation {
        let all = 0..poses.len();
        let posed = pose_all(self.problem, poses);
        let sum = |term: &dyn Term| -> f64 {
            let at = |t: usize| At { frame: t, pose: &poses[t], posed: &posed[t] };
            all.clone().map(|t| term.energy(&self.problem.context, &at(t))).sum()
        };
        let mut parts: Vec<f64> = self.problem.terms.par_iter().map(|t| sum(*t)).collect();
        parts.push(self.problem.smoothness.map_or(0.0, |s| s.energy(&posed, &all)));
        let frames: Vec<Value> = all
            .clone()
            .into_par_iter()
            .map(|t| self.model.evaluate(self.losses, &self.observed[t], &self.lights[t], &poses[t], true))
            .collect();
        let losses = self.losses.iter().enumerate();
        parts.extend(losses.map(|(k, l)| l.weight * frames.iter().map(|f| f.losses[k]).sum::<f64>()));
        // Normal equations hold half the gradient.
        let geometric = linearize(self.problem, poses, &posed, &all).gradient;
        let rendered = frames.iter().flat_map(|f| &f.gradient);
        let gradient = geometric.iter().zip(rendered).map(|(g, r)| 2.0 * g + r).collect();
        Evaluation { parts, gradient }
    }

    fn precondition(&self, gradient: &[f64]) -> Vec<f64> {
        self.metric.solve(gradient).iter().map(|v| 0.5 * v).collect()
    }

    fn retract(&self, poses: &Vec<FramePose>, step: &[f64]) -> Vec<FramePose> {
        retract(self.problem, poses, &(0..poses.len()), step)
    }
}

//! All terms of all frames as one function: residuals that are linearised, and rendered losses.

use crate::quasi_newton::{Evaluation, Objective};
use crate::rendered::{Model, Observed, Value, Weighted};
use crate::solver::{Problem, linearize, pose_all, retract};
use crate::stage1::flesh::Flesh;
use crate::terms::{At, Term};
use animimic_math::block_tridiagonal::Factor;
use animimic_render::Light;
use animimic_rig::FramePose;
use rayon::prelude::*;

/// The sum of all terms over all frames.
pub struct Combined<'a> {
    /// Terms of the last linearisation, and smoothness.
    pub problem: &'a Problem<'a>,
    /// What is drawn.
    pub model: Model<'a>,
    /// How the surface is off the skin, if it is.
    pub flesh: Option<&'a Flesh>,
    /// Rendered losses.
    pub losses: &'a [Weighted<'a>],
    /// What the video shows \[frame\].
    pub observed: &'a [Observed<'a>],
    /// The light \[frame\].
    pub lights: &'a [Light],
    /// The metric of steps: the factor of a damped Gauss–Newton matrix.
    pub metric: Factor,
}

impl Objective for Combined<'_> {
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
            .map(|t| {
                let evaluate =
                    |model: Model| model.evaluate(self.losses, &self.observed[t], &self.lights[t], &poses[t], true);
                let Some(flesh) = self.flesh else { return evaluate(self.model) };
                evaluate(Model { vertices: &flesh.anchors(t), ..self.model })
            })
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

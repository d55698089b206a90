//! Anchors that should project to known pixels: tracks, model-to-frame flow, contours.
//!
//! E = Σ w ρ(‖A (π(x) − u*)‖): A = identity for a track (both directions known), A = a row nᵀ for a contour or an edge
//! (only the direction along the normal n is known, the aperture problem).

use super::{At, Context, Term};
use crate::normal::NormalEquations;
use crate::robust::Robust;
use crate::view::project;
use glam::DVec2;

/// One anchor's observed pixel in one frame.
#[derive(Clone, Copy, Debug)]
pub struct PixelTarget {
    /// Anchor index in the context.
    pub anchor: u32,
    /// Observed pixel.
    pub pixel: DVec2,
    /// Weight w.
    pub weight: f64,
    /// `None`: both directions count; a unit normal: only the distance along it.
    pub normal: Option<DVec2>,
}

/// All pixel targets of one kind.
#[derive(Clone, Debug)]
pub struct Pixels {
    /// Targets \[frame\].
    pub targets: Vec<Vec<PixelTarget>>,
    /// Loss of the distance [px].
    pub robust: Robust,
    /// Overall weight.
    pub weight: f64,
}

impl Term for Pixels {
    fn name(&self) -> &'static str {
        "pixels"
    }

    fn energy(&self, context: &Context, at: &At) -> f64 {
        let energy: f64 = self.targets[at.frame]
            .iter()
            .map(|t| {
                let seen = context.camera.project(context.anchors[t.anchor as usize].position(at.posed));
                let r = seen - t.pixel;
                t.weight * self.robust.loss(t.normal.map_or(r.length(), |n| n.dot(r).abs()))
            })
            .sum();
        self.weight * energy
    }

    fn linearize(&self, context: &Context, at: &At, normal: &mut NormalEquations) {
        let mut row = Vec::new();
        for t in &self.targets[at.frame] {
            let anchor = &context.anchors[t.anchor as usize];
            let columns = &context.columns[t.anchor as usize];
            let seen = project(context.camera, anchor.position(at.posed));
            let r = seen.pixel - t.pixel;
            let weight = self.weight * t.weight * self.robust.weight(t.normal.map_or(r.length(), |n| n.dot(r).abs()));
            let mut add = |direction: glam::DVec3, residual: f64| {
                row.clear();
                anchor.push_row(columns, context.kinematics, at.posed, direction, &mut row);
                normal.add_row(&row, residual, weight);
            };
            match t.normal {
                Some(n) => add(seen.du * n.x + seen.dv * n.y, n.dot(r)),
                None => {
                    add(seen.du, r.x);
                    add(seen.dv, r.y);
                }
            }
        }
    }
}

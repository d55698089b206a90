//! Observed depth with unknown scale and shift per frame.
//!
//! E = Σ w ρ((a f(z(x)) + b − d)/σ), f(z) = z for metric depth and 1/z for inverse depth, a and b eliminated in closed form (variable projection, Golub & Pereyra 1973). Fitted in
//! observed-depth space: the other direction lets the model collapse flat.

use super::{At, Context, Term};
use crate::normal::NormalEquations;
use crate::robust::Robust;
use animimic_scene::DepthKind;

/// One anchor's observed depth in one frame.
#[derive(Clone, Copy, Debug)]
pub struct DepthTarget {
    /// Anchor index in the context.
    pub anchor: u32,
    /// Observed depth, in the estimator's own unit.
    pub depth: f64,
    /// Weight.
    pub weight: f64,
}

/// Depth targets of all frames.
#[derive(Clone, Debug)]
pub struct Depth {
    /// Targets \[frame\].
    pub targets: Vec<Vec<DepthTarget>>,
    /// Standard deviation of the observed depth, in its own unit.
    pub sigma: f64,
    /// Loss of (a f(z) + b − d)/σ.
    pub robust: Robust,
    /// Overall weight.
    pub weight: f64,
    /// Whether scale and shift are unknown (estimated depth) or 1 and 0 (measured depth).
    pub affine: bool,
    /// What the values mean: f.
    pub kind: DepthKind,
}

/// Where the variance of f(z) within a frame is below this share of its mean square, the scale is not determined.
const LEAST_VARIANCE: f64 = 1e-12;
/// Inverse depth is taken no nearer than this [model unit]: it is singular at the camera.
const NEAREST_DEPTH: f64 = 1e-6;

/// Reweighting of scale and shift ends here at the latest.
const MAX_AFFINE_ITERATIONS: usize = 50;

struct Fit {
    scale: f64,
    shift: f64,
    /// f(z) \[target\].
    depths: Vec<f64>,
}

/// f(z): what an estimator of this kind would say.
pub(crate) fn reading(kind: DepthKind, z: f64) -> f64 {
    match kind {
        DepthKind::Metric => z,
        DepthKind::Inverse => 1.0 / z.max(NEAREST_DEPTH),
    }
}

/// f'(z) at a value of f.
pub(crate) fn slope(kind: DepthKind, reading: f64) -> f64 {
    match kind {
        DepthKind::Metric => 1.0,
        DepthKind::Inverse => -reading * reading,
    }
}

impl Depth {
    fn fit(&self, context: &Context, at: &At) -> Fit {
        let targets = &self.targets[at.frame];
        let axis = |t: &DepthTarget| {
            reading(self.kind, context.camera.to_view(context.anchors[t.anchor as usize].position(at.posed)).z)
        };
        let depths: Vec<f64> = targets.iter().map(axis).collect();
        if !self.affine {
            return Fit { scale: 1.0, shift: 0.0, depths };
        }
        let (mut scale, mut shift) = (0.0, 0.0);
        // Scale and shift of the *robust* energy, so that eliminating them leaves an exact gradient.
        for iteration in 0..MAX_AFFINE_ITERATIONS {
            let weight = |i: usize| {
                let r = (scale * depths[i] + shift - targets[i].depth) / self.sigma;
                targets[i].weight * if iteration == 0 { 1.0 } else { self.robust.weight(r.abs()) }
            };
            let w: f64 = (0..depths.len()).map(weight).sum::<f64>().max(1e-300);
            let mean =
                |f: &dyn Fn(usize) -> f64| -> f64 { (0..depths.len()).map(|i| weight(i) * f(i)).sum::<f64>() / w };
            let (mz, md) = (mean(&|i| depths[i]), mean(&|i| targets[i].depth));
            let covariance = mean(&|i| (depths[i] - mz) * (targets[i].depth - md));
            let variance = mean(&|i| (depths[i] - mz).powi(2));
            let next = covariance / (variance + LEAST_VARIANCE * mz * mz).max(1e-300);
            let change = (next - scale).abs();
            (scale, shift) = (next, md - next * mz);
            if change <= 1e-13 * scale.abs() || (iteration > 0 && self.robust == Robust::Squared) {
                break;
            }
        }
        Fit { scale, shift, depths }
    }
}

impl Term for Depth {
    fn name(&self) -> &'static str {
        "depth"
    }

    fn energy(&self, context: &Context, at: &At) -> f64 {
        let fit = self.fit(context, at);
        let residual =
            |i: usize| (fit.scale * fit.depths[i] + fit.shift - self.targets[at.frame][i].depth) / self.sigma;
        let sum: f64 =
            (0..fit.depths.len()).map(|i| self.targets[at.frame][i].weight * self.robust.loss(residual(i).abs())).sum();
        self.weight * sum
    }

    fn linearize(&self, context: &Context, at: &At, normal: &mut NormalEquations) {
        let fit = self.fit(context, at);
        let axis = context.camera.view_from_world.matrix3.row(2);
        let d = normal.dimension;
        // JᵀWA (two dense vectors) and AᵀWA (2×2) for the elimination of scale and shift.
        let mut coupling = [vec![0.0; d], vec![0.0; d]];
        let mut inner = [0.0; 3];
        let mut row = Vec::new();
        for (t, &z) in self.targets[at.frame].iter().zip(&fit.depths) {
            let slope = slope(self.kind, z) * fit.scale / self.sigma;
            let r = (fit.scale * z + fit.shift - t.depth) / self.sigma;
            let w = self.weight * t.weight * self.robust.weight(r.abs());
            row.clear();
            let anchor = &context.anchors[t.anchor as usize];
            let columns = &context.columns[t.anchor as usize];
            anchor.push_row(columns, context.kinematics, at.posed, axis * slope, &mut row);
            normal.add_row(&row, r, w);
            for &(i, v) in &row {
                coupling[0][i] += w * v * z;
                coupling[1][i] += w * v;
            }
            inner = [inner[0] + w * z * z, inner[1] + w * z, inner[2] + w];
        }
        if self.affine {
            eliminate(normal, &coupling, inner);
        }
    }
}

/// H −= C (AᵀWA)⁻¹ Cᵀ for a 2×2 inner matrix, through its Cholesky factor.
fn eliminate(normal: &mut NormalEquations, coupling: &[Vec<f64>; 2], inner: [f64; 3]) {
    let [zz, z, one] = inner;
    if one <= 0.0 || zz - z * z / one <= LEAST_VARIANCE * zz {
        return;
    }
    normal.add_outer(&coupling[1], -1.0 / one);
    let rest: Vec<f64> = coupling[0].iter().zip(&coupling[1]).map(|(a, b)| a - b * z / one).collect();
    normal.add_outer(&rest, -1.0 / (zz - z * z / one));
}

//! Body parts do not pass through each other: balls inside them keep their distance.
//!
//! E = k Σ_(a,b) max(0, c_ab − |x_a − x_b|)², over pairs of balls of parts that do not touch at rest; c_ab is the sum of the radii.

use super::{At, Context, Term};
use crate::normal::NormalEquations;
use glam::DVec3;

/// Two balls that may not come nearer than a clearance.
#[derive(Clone, Copy, Debug)]
pub struct BallPair {
    /// Anchors of their centres.
    pub anchors: [u32; 2],
    /// Sum of their radii [model unit].
    pub clearance: f64,
}

/// All pairs, the same in every frame.
#[derive(Clone, Debug)]
pub struct Penetration {
    /// Pairs.
    pub pairs: Vec<BallPair>,
    /// Stiffness k [1/model unit²].
    pub weight: f64,
}

impl Penetration {
    /// Unit direction from b to a and the overlap, where there is one.
    fn overlap(&self, pair: &BallPair, context: &Context, at: &At) -> Option<(DVec3, f64)> {
        let [a, b] = pair.anchors.map(|i| context.anchors[i as usize].position(at.posed));
        let overlap = pair.clearance - a.distance(b);
        // Coincident centres have no direction to part in; the other balls of the two parts do.
        (overlap > 0.0).then(|| (a - b).try_normalize()).flatten().map(|u| (u, overlap))
    }
}

impl Term for Penetration {
    fn name(&self) -> &'static str {
        "penetration"
    }

    fn energy(&self, context: &Context, at: &At) -> f64 {
        let overlaps = self.pairs.iter().filter_map(|p| self.overlap(p, context, at));
        self.weight * overlaps.map(|(_, overlap)| overlap * overlap).sum::<f64>()
    }

    fn linearize(&self, context: &Context, at: &At, normal: &mut NormalEquations) {
        for pair in &self.pairs {
            let Some((u, overlap)) = self.overlap(pair, context, at) else { continue };
            let mut row = Vec::new();
            for (anchor, direction) in pair.anchors.into_iter().zip([-u, u]) {
                let i = anchor as usize;
                let mut part = Vec::new();
                context.anchors[i].push_row(&context.columns[i], context.kinematics, at.posed, direction, &mut part);
                row.extend(part);
            }
            normal.add_row(&merged(row), overlap, self.weight);
        }
    }
}

/// A row with ascending parameters, each once.
fn merged(mut row: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    row.sort_by_key(|e| e.0);
    row.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    row
}

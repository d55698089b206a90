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
pub struct Penetration<'a> {
    /// Pairs.
    pub pairs: &'a [BallPair],
    /// Stiffness k [1/model unit²].
    pub weight: f64,
}

impl Penetration<'_> {
    /// Pairs that overlap: unit direction from the second to the first centre, and by how much.
    fn overlaps<'a>(&'a self, context: &Context, at: &At) -> impl Iterator<Item = (&'a BallPair, DVec3, f64)> + 'a {
        // A ball is in many pairs: each centre once.
        let count = self.pairs.iter().flat_map(|p| p.anchors).max().map_or(0, |last| last as usize + 1);
        let centers: Vec<DVec3> = context.anchors[..count].iter().map(|a| a.position(at.posed)).collect();
        self.pairs.iter().filter_map(move |pair| {
            let [a, b] = pair.anchors.map(|i| centers[i as usize]);
            let overlap = pair.clearance - a.distance(b);
            // Coincident centres have no direction to part in; the other balls of the two parts do.
            let apart = (overlap > 0.0).then(|| (a - b).try_normalize()).flatten();
            apart.map(|u| (pair, u, overlap))
        })
    }
}

impl Term for Penetration<'_> {
    fn name(&self) -> &'static str {
        "penetration"
    }

    fn energy(&self, context: &Context, at: &At) -> f64 {
        self.weight * self.overlaps(context, at).map(|(_, _, overlap)| overlap * overlap).sum::<f64>()
    }

    fn linearize(&self, context: &Context, at: &At, normal: &mut NormalEquations) {
        for (pair, u, overlap) in self.overlaps(context, at) {
            let mut row = Vec::new();
            for (anchor, direction) in pair.anchors.into_iter().zip([-u, u]) {
                let i = anchor as usize;
                let (anchor, columns) = (&context.anchors[i], &context.columns[i]);
                anchor.push_row(columns, context.kinematics, at.posed, direction, &mut row);
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

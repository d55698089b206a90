//! Temporal smoothness over *all* vertices at a cost that does not depend on their number.
//!
//! Σ_v ‖Σ_j w_vj ΔT_j X̃_v‖² / V = tr(ΔT B ΔTᵀ), T = [T_1 … T_J] (3 × 4J), B = Σ_v b_v b_vᵀ / V the constant Gram matrix with
//! b_v = (w_vj X_v, w_vj)_j. With B = L Lᵀ every column of L is a pseudo-anchor: the smoothness of all vertices is the sum of the
//! squared second differences of these few points.

use crate::anchor::{Anchor, Share};
use glam::DVec3;

/// Columns whose pivot falls below this share of the largest are dropped: they hold under 1e-9 of the mean squared motion.
const RANK_TOLERANCE: f64 = 1e-9;

/// Pseudo-anchors whose squared motion sums to the mean squared motion of `vertices` (pivoted Cholesky of the Gram matrix).
pub fn pseudo_anchors(vertices: &[Anchor], joints: usize) -> Vec<Anchor> {
    let n = 4 * joints;
    let mut gram = vec![0.0; n * n];
    for a in vertices {
        for s in &a.shares {
            let bs = homogeneous(s);
            for t in &a.shares {
                let bt = homogeneous(t);
                for (r, x) in bs.iter().enumerate() {
                    for (c, y) in bt.iter().enumerate() {
                        gram[(4 * s.joint + r) * n + 4 * t.joint + c] += x * y / vertices.len() as f64;
                    }
                }
            }
        }
    }
    pivoted_cholesky(gram, n).iter().map(|column| anchor_from_column(column)).collect()
}

fn homogeneous(s: &Share) -> [f64; 4] {
    [s.weighted_rest.x, s.weighted_rest.y, s.weighted_rest.z, s.weight]
}

fn anchor_from_column(column: &[f64]) -> Anchor {
    let shares = column
        .chunks_exact(4)
        .enumerate()
        .filter(|(_, c)| c.iter().any(|v| *v != 0.0))
        .map(|(joint, c)| Share { joint, weight: c[3], weighted_rest: DVec3::new(c[0], c[1], c[2]) })
        .collect();
    Anchor { shares }
}

/// Columns l with A = Σ l lᵀ up to the rank tolerance, largest pivot first.
fn pivoted_cholesky(mut a: Vec<f64>, n: usize) -> Vec<Vec<f64>> {
    let mut columns = Vec::new();
    let largest = (0..n).map(|i| a[i * n + i]).fold(0.0, f64::max);
    for _ in 0..n {
        let Some(p) = (0..n).max_by(|&i, &j| a[i * n + i].total_cmp(&a[j * n + j])) else { break };
        let pivot = a[p * n + p];
        if pivot <= RANK_TOLERANCE * largest {
            break;
        }
        let column: Vec<f64> = (0..n).map(|i| a[i * n + p] / pivot.sqrt()).collect();
        for i in 0..n {
            if column[i] != 0.0 {
                for j in 0..n {
                    a[i * n + j] -= column[i] * column[j];
                }
            }
        }
        columns.push(column);
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::Kinematics;
    use animimic_math::gradcheck::SplitMix64;

    #[test]
    fn pseudo_anchors_carry_the_mean_squared_motion_of_all_vertices() {
        let mut rng = SplitMix64(3);
        let mut point = || DVec3::new(rng.normal(), rng.normal(), rng.normal());
        let pivots = vec![point(), point(), point()];
        let rest: Vec<DVec3> = (0..200).map(|_| point()).collect();
        let anchors: Vec<Anchor> = rest
            .iter()
            .enumerate()
            .map(|(i, &x)| {
                let w = (i % 11) as f64 / 10.0;
                let share = |joint, weight: f64| Share { joint, weight, weighted_rest: x * weight };
                Anchor { shares: vec![share(i % 2, w), share(2, 1.0 - w)] }
            })
            .collect();
        let tree = Kinematics::new(vec![None, Some(0), Some(1)], pivots, vec![true; 3], vec![true, false, false]);
        let step: Vec<f64> = (0..tree.dimension).map(|i| 0.3 * (i as f64).sin()).collect();
        let (a, b) = (tree.pose(&tree.rest()), tree.pose(&tree.retract(&tree.rest(), &step)));
        let motion = |anchors: &[Anchor]| -> f64 {
            anchors.iter().map(|p| (p.position(&b) - p.position(&a)).length_squared()).sum()
        };
        let (exact, reduced) = (motion(&anchors) / 200.0, motion(&pseudo_anchors(&anchors, 3)));
        println!("relative difference {:.1e}", (exact - reduced).abs() / exact);
        assert!((exact - reduced).abs() < 1e-8 * exact);
    }
}

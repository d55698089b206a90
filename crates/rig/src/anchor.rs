//! Surface points that move with the skin, and their Jacobian with respect to a frame's parameters.

use crate::kinematics::{Kinematics, Posed};
use animimic_scene::Skin;
use glam::{DAffine3, DVec3};

/// One joint's share in an anchor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
    /// Joint index.
    pub joint: usize,
    /// Weight w.
    pub weight: f64,
    /// w · X: weighted rest-world position [model unit].
    pub weighted_rest: DVec3,
}

/// A point of the surface as a linear blend: x = Σ_j T_j (w_j X_j).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Anchor {
    /// Shares, by ascending joint; weights sum to 1.
    pub shares: Vec<Share>,
}

/// Which parameters move an anchor: static structure of its Jacobian.
#[derive(Clone, Debug, Default)]
pub struct AnchorColumns {
    /// Joints above (or at) any share that may turn or slide, ascending.
    pub joints: Vec<usize>,
    /// For each of `joints`, the shares it moves.
    below: Vec<Vec<usize>>,
}

impl Anchor {
    /// A vertex of a skinned mesh. `rest_world[slot]` = G_joint⁰ · B_slot, the slot's map from the vertex buffer to displayed rest
    /// space; `joint_of` maps skeleton joints to the joints of the [`Kinematics`].
    pub fn vertex(skin: &Skin, rest_world: &[DAffine3], joint_of: &[usize], vertex: usize) -> Self {
        let x = skin.bind_positions[vertex];
        Self::merged(skin.influences[vertex].iter().map(|i| {
            let slot = i.slot as usize;
            Share {
                joint: joint_of[skin.slots[slot].joint],
                weight: i.weight,
                weighted_rest: rest_world[slot].transform_point3(x) * i.weight,
            }
        }))
    }

    /// A point inside a triangle: barycentric blend of three vertices' anchors.
    pub fn blend(corners: [&Anchor; 3], barycentric: [f64; 3]) -> Self {
        Self::merged(corners.iter().zip(barycentric).flat_map(|(corner, b)| {
            corner.shares.iter().map(move |s| Share {
                joint: s.joint,
                weight: s.weight * b,
                weighted_rest: s.weighted_rest * b,
            })
        }))
    }

    /// The anchor times a factor: how it moves counts that much.
    pub fn scaled(&self, factor: f64) -> Self {
        let times = |s: &Share| Share { weight: s.weight * factor, weighted_rest: s.weighted_rest * factor, ..*s };
        Self { shares: self.shares.iter().map(times).collect() }
    }

    /// The same with each share's joint replaced by the one that carries it.
    pub fn carried(&self, carrier: impl Fn(usize) -> usize) -> Self {
        // What a share adds at rest does not depend on the joint: displacements are from rest.
        Self::merged(self.shares.iter().map(|s| Share { joint: carrier(s.joint), ..*s }))
    }

    /// The same with the rest position of each joint's share moved by `by` [model unit].
    pub fn shifted(&self, by: impl Fn(usize) -> DVec3) -> Self {
        let moved = |s: &Share| Share { weighted_rest: s.weighted_rest + by(s.joint) * s.weight, ..*s };
        Self { shares: self.shares.iter().map(moved).collect() }
    }

    fn merged(shares: impl Iterator<Item = Share>) -> Self {
        let mut all: Vec<Share> = shares.collect();
        all.sort_by_key(|s| s.joint);
        let mut merged: Vec<Share> = Vec::with_capacity(all.len());
        for s in all {
            match merged.last_mut() {
                Some(last) if last.joint == s.joint => {
                    last.weight += s.weight;
                    last.weighted_rest += s.weighted_rest;
                }
                _ => merged.push(s),
            }
        }
        Self { shares: merged }
    }

    /// Posed position [model unit].
    pub fn position(&self, posed: &Posed) -> DVec3 {
        self.shares.iter().map(|s| share_position(s, posed)).sum()
    }

    /// The joint with the largest weight.
    pub fn main_joint(&self) -> usize {
        self.shares.iter().max_by(|a, b| a.weight.total_cmp(&b.weight)).map_or(0, |s| s.joint)
    }

    /// The structure of the Jacobian.
    pub fn columns(&self, kinematics: &Kinematics) -> AnchorColumns {
        let mut columns = AnchorColumns::default();
        let moves = |j: usize| kinematics.turns[j] || kinematics.slides[j];
        for s in &self.shares {
            let mut at = Some(s.joint);
            while let Some(j) = at {
                if moves(j) && !columns.joints.contains(&j) {
                    columns.joints.push(j);
                }
                at = kinematics.parents[j];
            }
        }
        columns.joints.sort_unstable();
        columns.below = columns
            .joints
            .iter()
            .map(|&j| (0..self.shares.len()).filter(|&k| kinematics.is_ancestor(j, self.shares[k].joint)).collect())
            .collect();
        columns
    }

    /// Row ∂(g·x)/∂θ of the anchor's position in direction g, as (parameter, value) pairs appended to `row`.
    ///
    /// ∂x/∂δ_jk = (Rg_j e_k) × (Σ_{b below j} x_b − W_j c_j), hence g·∂x/∂δ_j = Rg_jᵀ (lever_j × g);
    /// ∂x/∂t_j = W_j · Rg_parent(j).
    pub fn push_row(
        &self,
        columns: &AnchorColumns,
        kinematics: &Kinematics,
        posed: &Posed,
        g: DVec3,
        row: &mut Vec<(usize, f64)>,
    ) {
        for (&j, below) in columns.joints.iter().zip(&columns.below) {
            let (mut weight, mut moved) = (0.0, DVec3::ZERO);
            for &k in below {
                weight += self.shares[k].weight;
                moved += share_position(&self.shares[k], posed);
            }
            if let Some(o) = kinematics.turn_offset[j] {
                let lever = moved - posed.centers[j] * weight;
                let d = posed.transforms[j].matrix3.transpose() * lever.cross(g);
                row.extend([(o, d.x), (o + 1, d.y), (o + 2, d.z)]);
            }
            if let Some(o) = kinematics.slide_offset[j] {
                let d = kinematics.slide_axes(posed, j).transpose() * g * weight;
                row.extend([(o, d.x), (o + 1, d.y), (o + 2, d.z)]);
            }
        }
    }
}

fn share_position(s: &Share, posed: &Posed) -> DVec3 {
    let t = &posed.transforms[s.joint];
    t.matrix3 * s.weighted_rest + t.translation * s.weight
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{creature, creature_with_stray_weight};
    use crate::solve_tree::SolveTree;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};

    #[test]
    fn rows_are_the_derivatives_of_positions_for_every_kind_of_joint_and_blend() {
        for (rig, mesh) in [creature(), creature_with_stray_weight()] {
            let tree = SolveTree::new(&rig, &mesh);
            let kinematics = &tree.kinematics;
            let vertices = tree.vertex_anchors(&rig);
            let mut rng = SplitMix64(11);
            let start: Vec<f64> = (0..kinematics.dimension).map(|_| 0.5 * rng.normal()).collect();
            let pose = kinematics.retract(&kinematics.rest(), &start);
            let posed = kinematics.pose(&pose);
            let mut worst = 0.0f64;
            for corners in (0..vertices.len() - 20).step_by(5) {
                let [a, b, c] = [corners, corners + 9, corners + 20].map(|v| &vertices[v]);
                let anchor = Anchor::blend([a, b, c], [0.2, 0.5, 0.3]);
                let g = DVec3::new(rng.normal(), rng.normal(), rng.normal());
                let mut row = Vec::new();
                anchor.push_row(&anchor.columns(kinematics), kinematics, &posed, g, &mut row);
                assert!(row.windows(2).all(|w| w[0].0 < w[1].0), "parameters ascend");
                let mut gradient = vec![0.0; kinematics.dimension];
                row.iter().for_each(|&(i, v)| gradient[i] += v);
                let f = |step: &[f64]| g.dot(anchor.position(&kinematics.pose(&kinematics.retract(&pose, step))));
                let zero = vec![0.0; kinematics.dimension];
                worst = worst.max(gradient_error(f, &zero, &gradient, 3, &[1e-3, 1e-4, 1e-5], 2));
            }
            println!("largest relative error {worst:.1e}");
            assert!(worst < 1e-7);
        }
    }
}

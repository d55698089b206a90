//! The surface that goes with the tets.
//!
//! x_v = Σ_k b_vk y_k + h_v (s_v − Σ_k b_vk ŷ_k): the embedding in the simulated cage y, and of what skinning s adds to the
//! *skinned cage* ŷ (eyelids, fingers, creases below the size of a cell) the held share h_v. It is 1 in driven parts and at the
//! roots of loose flesh, where y = ŷ and so x = s, and where a joint is too small for the cage to hold; 0 where tissue is free: there creases and
//! collapses of skinning are gone. At rest x is the rest surface exactly, since all three agree.
//!
//! Where softness p is painted ([`animimic_scene::Mesh::softness`]) the surface goes that share of the way: s_v + p (x_v − s_v) =
//! Σ_k p b y + (1 − p (1 − h)) s − h Σ_k p b ŷ.

use super::Tissue;
use super::weights::CageWeights;
use animimic_scene::Asset;
use animimic_sim::tet::Cage;
use glam::{DAffine3, DVec3};

/// Fixed coefficients of the surface.
#[derive(Clone, Debug, Default)]
pub struct Skinning {
    /// Cage vertices of each surface vertex, and p b.
    pub corners: Vec<([u32; 4], [f64; 4])>,
    /// h, per surface vertex.
    pub held: Vec<f64>,
    /// 1 − p (1 − h), per surface vertex.
    pub skinned: Vec<f64>,
}

impl Skinning {
    pub(super) fn new(asset: &Asset, cage: &Cage, weights: &CageWeights, skinned: &[bool], holding: &[bool]) -> Self {
        let rig = &asset.rig;
        let tets = cage.embedding.tet.iter().map(|&t| cage.mesh.tets[t as usize]);
        let corners: Vec<([u32; 4], [f64; 4])> = tets.zip(cage.embedding.barycentric.iter().copied()).collect();
        let of = |v: usize| {
            let (tet, b) = &corners[v];
            let driven: f64 = tet.iter().zip(b).filter(|(k, _)| skinned[**k as usize]).map(|(_, b)| b).sum();
            let detail: f64 = rig.skin.influences[v]
                .iter()
                .filter(|i| {
                    let joint = rig.skin.slots[i.slot as usize].joint;
                    weights.joints.binary_search(&joint).is_ok_and(|c| !holding[c])
                })
                .map(|i| i.weight)
                .sum();
            smooth(driven.max(detail))
        };
        let held: Vec<f64> = (0..corners.len()).map(of).collect();
        let painted = |v: usize| asset.mesh.softness.get(v).map_or(1.0, |p| f64::from(*p));
        let skinned = held.iter().enumerate().map(|(v, h)| 1.0 - painted(v) * (1.0 - h)).collect();
        let corners = corners.into_iter().enumerate().map(|(v, (tet, b))| (tet, b.map(|b| painted(v) * b))).collect();
        Self { corners, held, skinned }
    }
}

/// 3u² − 2u³ on [0, 1]: flat at both ends.
fn smooth(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}

impl Tissue<'_> {
    /// Surface positions [model unit] for cage positions [m] in a pose of the joints.
    pub fn surface(&self, cage: &[DVec3], world_from_joint: &[DAffine3]) -> Vec<DVec3> {
        let displacements = self.displaced(world_from_joint, |_| true);
        let offset = self.held_offset(&displacements);
        let embedded = |(tet, b): &([u32; 4], [f64; 4])| -> DVec3 {
            // As displacements: no rounding of large coordinates at rest.
            tet.iter().zip(b).map(|(&k, b)| (cage[k as usize] - self.body.rest[k as usize]) * *b).sum::<DVec3>()
                / self.scale
        };
        let rest = &self.asset.mesh.positions;
        self.skinning.corners.iter().zip(rest).zip(offset).map(|((c, x), o)| *x + embedded(c) + o).collect()
    }

    /// What skinning gives a surface vertex, (1 − p (1 − h)) s − h Σ p b ŷ, less its value at rest [model unit]: the part of the surface that
    /// does not depend on the simulation.
    pub fn held_offset(&self, displacements: &[DAffine3]) -> Vec<DVec3> {
        let moved = self.skinned_cage(displacements);
        let rig = &self.asset.rig;
        let rest = &self.asset.mesh.positions;
        let one = |v: usize| {
            let (h, share) = (self.skinning.held[v], self.skinning.skinned[v]);
            if share == 0.0 {
                return DVec3::ZERO;
            }
            let skinned: DVec3 = rig.skin.influences[v]
                .iter()
                .map(|i| {
                    let t = &displacements[rig.skin.slots[i.slot as usize].joint];
                    (t.transform_point3(rest[v]) - rest[v]) * i.weight
                })
                .sum();
            let (tet, b) = &self.skinning.corners[v];
            let cage: DVec3 = tet.iter().zip(b).map(|(&k, b)| moved[k as usize] * *b).sum();
            share * skinned - h * cage
        };
        (0..rest.len()).map(one).collect()
    }

    /// Displacements from rest of the cage's vertices under plain skinning [model unit].
    pub fn skinned_cage(&self, displacements: &[DAffine3]) -> Vec<DVec3> {
        (0..self.cage.mesh.positions.len()).map(|v| self.skinned_cage_vertex(v, displacements)).collect()
    }

    /// The same of one vertex.
    pub(super) fn skinned_cage_vertex(&self, vertex: usize, displacements: &[DAffine3]) -> DVec3 {
        let x = self.cage.mesh.positions[vertex];
        let carried = self.weights.rows[vertex].iter().zip(&self.weights.joints).filter(|(w, _)| **w > 0.0);
        carried.map(|(w, &j)| (displacements[j].transform_point3(x) - x) * *w).sum()
    }

    /// ∂L/∂(cage positions) [1/m] from ∂L/∂(surface positions) [1/model unit].
    pub fn surface_vjp(&self, d_surface: &[DVec3]) -> Vec<DVec3> {
        let mut d_cage = vec![DVec3::ZERO; self.body.rest.len()];
        for ((tet, b), d) in self.skinning.corners.iter().zip(d_surface).filter(|(_, d)| **d != DVec3::ZERO) {
            for (&k, b) in tet.iter().zip(b) {
                d_cage[k as usize] += *d * (*b / self.scale);
            }
        }
        d_cage
    }
}

impl Tissue<'_> {
    /// ∂(surface) [model unit] for a change of the cage's free vertices [m], 3 numbers each in the order of `body.free`.
    pub fn surface_column(&self, free: &[f64]) -> Vec<DVec3> {
        let mut cage = vec![DVec3::ZERO; self.body.rest.len()];
        for (&v, d) in self.body.free.iter().zip(free.as_chunks::<3>().0) {
            cage[v as usize] = DVec3::from_array(*d) / self.scale;
        }
        let embedded =
            |(tet, b): &([u32; 4], [f64; 4])| -> DVec3 { tet.iter().zip(b).map(|(&k, b)| cage[k as usize] * *b).sum() };
        self.skinning.corners.iter().map(embedded).collect()
    }
}

//! Flesh that is off the skin: what it adds to skinning in each frame, fixed to the bones that carry it.
//!
//! Where soft tissue lags behind or bulges, a surface point is at x = Σ_j T_j (w_j X_j) + δ. With δ turned along with the bones that
//! carry the point, δ ↦ Σ_j w_j R_j R_j'ᵀ δ (R' the rotations at which it was taken), poses can be solved again for a surface
//! that is not the skinned one: the first step of a block-wise descent, of which the simulation is the other.

use super::subject::Subject;
use animimic_rig::{Anchor, FramePose};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Offsets of all vertices in all frames.
#[derive(Clone, Debug, Default)]
pub struct Flesh {
    /// The anchor of each vertex, with loose joints' shares at the joints that carry them.
    anchors: Vec<Anchor>,
    /// δ \[frame\]\[vertex\] [model unit].
    offsets: Vec<Vec<DVec3>>,
    /// R' \[frame\]\[joint\].
    rotations: Vec<Vec<DMat3>>,
}

impl Flesh {
    /// The offsets of `surfaces` \[frame\]\[vertex\] from the skin in `poses`; what hangs on the skeleton's joints `loose` is taken to be
    /// carried by the joint above them.
    pub fn new(subject: &Subject, loose: &[usize], poses: &[FramePose], surfaces: &[Vec<DVec3>]) -> Self {
        let tree = &subject.tree;
        let is_loose = |k: usize| tree.skeleton_joint.get(k).is_some_and(|j| loose.contains(j));
        let carrier = |k: usize| {
            let mut at = k;
            while let Some(p) = tree.kinematics.parents[at].filter(|_| is_loose(at)) {
                at = p;
            }
            at
        };
        let anchors: Vec<Anchor> = subject.vertices.iter().map(|a| a.carried(carrier)).collect();
        let offset = |(pose, surface): (&FramePose, &Vec<DVec3>)| {
            let posed = subject.posed(pose);
            let rotations = posed.transforms.iter().map(|t| t.matrix3).collect();
            (surface.iter().zip(&anchors).map(|(x, a)| *x - a.position(&posed)).collect(), rotations)
        };
        let (offsets, rotations) = poses.par_iter().zip(surfaces).map(offset).unzip();
        Self { anchors, offsets, rotations }
    }

    /// The anchor of every vertex in a frame.
    pub fn anchors(&self, frame: usize) -> Vec<Anchor> {
        let rotations = &self.rotations[frame];
        let shifted = |(a, d): (&Anchor, &DVec3)| a.shifted(|j| rotations[j].transpose() * *d);
        self.anchors.iter().zip(&self.offsets[frame]).map(shifted).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::with_stage;

    #[test]
    fn anchors_are_where_the_surface_is_and_turn_with_the_bones_that_carry_them() {
        with_stage(|stage, truth| {
            let subject = stage.subject;
            let bulge = |(v, x): (usize, DVec3)| x + 0.05 * DVec3::new((v as f64).sin(), 0.3, (3.0 * v as f64).cos());
            let skinned = |p: &FramePose| subject.skinned(&subject.posed(p));
            let surfaces: Vec<Vec<DVec3>> =
                truth.iter().map(|p| skinned(p).into_iter().enumerate().map(bulge).collect()).collect();
            let joint = subject.tree.skeleton_joint.len() - 1;
            let loose = [subject.tree.skeleton_joint[joint]];
            let flesh = Flesh::new(subject, &loose, truth, &surfaces);
            let frame = truth.len() - 1;
            let anchors = flesh.anchors(frame);
            let posed = subject.posed(&truth[frame]);
            let off = |(a, x): (&Anchor, &DVec3)| a.position(&posed).distance(*x);
            let worst = anchors.iter().zip(&surfaces[frame]).map(off).fold(0.0, f64::max);
            println!("off by {worst:.1e}");
            assert!(worst < 1e-12 * subject.diagonal.max(1.0));
            // A joint turned: so is the surface of what hangs on it alone. A loose joint turned: nothing moves.
            let mut turned = truth[frame].clone();
            let turn = DMat3::from_rotation_y(0.7);
            turned.rotations[0] = turn * turned.rotations[0];
            let (pivot, whole) = (posed.centers[0], subject.posed(&turned));
            let below = |a: &Anchor| a.shares.iter().all(|s| subject.tree.kinematics.is_ancestor(0, s.joint));
            let hanging: Vec<_> = anchors.iter().zip(&surfaces[frame]).filter(|(a, _)| below(a)).collect();
            let off = |(a, x): &(&Anchor, &DVec3)| a.position(&whole).distance(turn * (**x - pivot) + pivot);
            let worst = hanging.iter().map(off).fold(0.0, f64::max);
            println!("{} of {} vertices turn, off by {worst:.1e}", hanging.len(), anchors.len());
            assert!(!hanging.is_empty() && worst < 1e-9 * subject.diagonal.max(1.0));
            let mut swung = truth[frame].clone();
            swung.rotations[joint] = turn * swung.rotations[joint];
            let swung = subject.posed(&swung);
            assert!(anchors.iter().all(|a| a.position(&swung) == a.position(&posed)));
        });
    }
}

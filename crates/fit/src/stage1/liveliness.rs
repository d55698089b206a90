//! Smoothness measured against how lively each point is.
//!
//! How fast things move differs by a hundred times between videos, and between a paw and the belly it hangs from. What a point
//! does across the view is seen well; that it does no more along the view, and no more from frame to frame than on average, is
//! the most that can be said about it beforehand. So each point's accelerations are weighed by the inverse of their own mean
//! square across the view, estimated from the motion found so far (an empirical prior, Robbins 1956), and alike in all directions.

use super::solve::Stage;
use crate::smoothness::Smoothness;
use animimic_rig::smoothness::pseudo_anchors;
use animimic_rig::{Anchor, FramePose};
use glam::DVec3;
use rayon::prelude::*;

/// Accelerations below this are noise of what is seen [rest diagonal / frame²].
const NOISE: f64 = 3e-4;

/// A point's mean squares per direction across the view.
#[derive(Clone, Copy, Default)]
struct Liveliness {
    /// First differences [model unit²].
    velocity: f64,
    /// Second differences [model unit²].
    acceleration: f64,
}

impl Stage<'_> {
    /// Smoothness that weighs each vertex by its own liveliness in `poses`; `None` for a video too short to tell.
    pub(super) fn lively_smoothness(&self, poses: &[FramePose]) -> Option<Smoothness> {
        if poses.len() < 3 {
            return None;
        }
        let posed: Vec<_> = poses.iter().map(|p| self.subject.posed(p)).collect();
        let noise = NOISE * self.subject.diagonal;
        let lively: Vec<Liveliness> = self
            .subject
            .vertices
            .par_iter()
            .map(|a| self.liveliness(&posed.iter().map(|p| a.position(p)).collect::<Vec<_>>()))
            .collect();
        let weighed = |(a, l): (&Anchor, &Liveliness)| a.scaled(1.0 / (l.acceleration + noise * noise).sqrt());
        let weighed: Vec<Anchor> = self.subject.vertices.iter().zip(&lively).map(weighed).collect();
        let sum = |f: fn(&Liveliness) -> f64| lively.iter().map(f).sum::<f64>();
        let pace = sum(|l| l.acceleration) / sum(|l| l.velocity).max(noise * noise);
        Some(Smoothness {
            anchors: pseudo_anchors(&weighed, self.subject.tree.kinematics.len()),
            velocity: self.settings.lively_velocity * pace,
            acceleration: self.settings.lively_acceleration,
            basis: DVec3::AXES,
        })
    }

    fn liveliness(&self, path: &[DVec3]) -> Liveliness {
        let view = self.studio.camera.view_from_world.matrix3;
        let across = |d: DVec3| (view * d).truncate().length_squared() / 2.0;
        let mean = |n: usize, f: &dyn Fn(usize) -> DVec3| (0..n).map(|t| across(f(t))).sum::<f64>() / n as f64;
        Liveliness {
            velocity: mean(path.len() - 1, &|t| path[t + 1] - path[t]),
            acceleration: mean(path.len() - 2, &|t| path[t + 2] - 2.0 * path[t + 1] + path[t]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::with_stage;
    use animimic_math::so3;

    #[test]
    fn a_still_part_is_held_harder_than_a_lively_one_and_all_directions_alike() {
        with_stage(|stage, _| {
            let subject = stage.subject;
            let tree = &subject.tree.kinematics;
            let limb = &subject.limbs[0];
            let (lively, other) = (limb.levers[0], tree.parents[limb.levers[0]].expect("limbs hang on something"));
            let axis = stage.studio.camera.view_from_world.matrix3.row(2);
            let turned = |joint: usize, axis: DVec3, angle: f64| {
                let mut pose = tree.rest();
                pose.rotations[joint] = so3::exp(axis * angle);
                pose
            };
            // The limb swings in the image plane; all else is still.
            let moving: Vec<FramePose> = (0..8).map(|t| turned(lively, axis, 0.4 * (t as f64).sin())).collect();
            let smoothness = stage.lively_smoothness(&moving).expect("long enough");
            let price = |joint: usize, axis: DVec3| {
                let path = [tree.rest(), turned(joint, axis, 0.01), tree.rest()];
                smoothness.energy(&path.iter().map(|p| tree.pose(p)).collect::<Vec<_>>(), &(0..3))
            };
            let (same, across) = (price(lively, axis), price(lively, axis.any_orthonormal_vector()));
            let held = price(other, axis);
            println!("limb {same:.3e} in its plane, {across:.3e} across it; what holds it {held:.3e}");
            assert!(held > 100.0 * same, "its parent carries still points too");
            assert!(across < 4.0 * same && same < 4.0 * across);
            assert!(stage.lively_smoothness(&moving[..2]).is_none());
        });
    }
}

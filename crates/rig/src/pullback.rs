//! From forces on surface points to forces on joints: the adjoint of kinematics and skinning together.
//!
//! A turn of joint j moves everything below it: ∂L/∂δ_j = Rg_jᵀ (M_j − c_j × F_j) with F_j = Σ w g and M_j = Σ x × g summed over
//! all shares x of points at or below j and their forces g; ∂L/∂t_j = Rg_parentᵀ F_j. Both sums are made per joint and then once
//! up the tree, so the cost is that of reading the points, whatever the depth of the tree (no row per point is formed).

use crate::anchor::Anchor;
use crate::kinematics::{Kinematics, Posed};
use glam::DVec3;

/// ∂L/∂(increments of the pose) \[dimension\], as [`Kinematics::retract`] takes them, from `forces` = ∂L/∂(point positions).
///
/// # Panics
/// When there is not one force per point.
pub fn pose_vjp(kinematics: &Kinematics, posed: &Posed, points: &[Anchor], forces: &[DVec3]) -> Vec<f64> {
    assert_eq!(points.len(), forces.len(), "one force per point");
    let mut force = vec![DVec3::ZERO; kinematics.len()];
    let mut moment = vec![DVec3::ZERO; kinematics.len()];
    for (point, g) in points.iter().zip(forces).filter(|(_, g)| **g != DVec3::ZERO) {
        for s in &point.shares {
            let t = &posed.transforms[s.joint];
            force[s.joint] += *g * s.weight;
            moment[s.joint] += (t.matrix3 * s.weighted_rest + t.translation * s.weight).cross(*g);
        }
    }
    // Parents come first.
    for j in (0..kinematics.len()).rev() {
        if let Some(p) = kinematics.parents[j] {
            let (f, m) = (force[j], moment[j]);
            force[p] += f;
            moment[p] += m;
        }
    }
    let mut gradient = vec![0.0; kinematics.dimension];
    for j in 0..kinematics.len() {
        if let Some(o) = kinematics.turn_offset[j] {
            let turning = moment[j] - posed.centers[j].cross(force[j]);
            let d = posed.transforms[j].matrix3.transpose() * turning;
            gradient[o..o + 3].copy_from_slice(&d.to_array());
        }
        if let Some(o) = kinematics.slide_offset[j] {
            let d = kinematics.slide_axes(posed, j).transpose() * force[j];
            gradient[o..o + 3].copy_from_slice(&d.to_array());
        }
    }
    gradient
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{creature, creature_with_stray_weight};
    use crate::solve_tree::SolveTree;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};

    #[test]
    fn forces_on_vertices_become_the_gradient_to_every_joint() {
        for (rig, mesh) in [creature(), creature_with_stray_weight()] {
            let tree = SolveTree::new(&rig, &mesh);
            let (kinematics, vertices) = (&tree.kinematics, tree.vertex_anchors(&rig));
            let mut rng = SplitMix64(5);
            let start: Vec<f64> = (0..kinematics.dimension).map(|_| 0.5 * rng.normal()).collect();
            let pose = kinematics.retract(&kinematics.rest(), &start);
            let mut any = || DVec3::new(rng.normal(), rng.normal(), rng.normal());
            let forces: Vec<DVec3> = vertices.iter().map(|_| any()).collect();
            let gradient = pose_vjp(kinematics, &kinematics.pose(&pose), &vertices, &forces);
            let f = |step: &[f64]| -> f64 {
                let posed = kinematics.pose(&kinematics.retract(&pose, step));
                vertices.iter().zip(&forces).map(|(v, g)| v.position(&posed).dot(*g)).sum()
            };
            let error = gradient_error(f, &vec![0.0; kinematics.dimension], &gradient, 6, &[1e-3, 1e-4, 1e-5], 2);
            println!("relative error {error:.1e}");
            assert!(error < 1e-8);
        }
    }
}

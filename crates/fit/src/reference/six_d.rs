//! 6D rotations: the first two columns of R, made orthonormal by Gram and Schmidt (Zhou et al. 2019).

use animimic_rig::{FramePose, Kinematics};
use glam::{DMat3, DVec3};

/// How a frame's parameters are laid out: six numbers per joint that turns, then three if it slides, joint by joint.
#[derive(Clone, Debug)]
pub struct SixD {
    kinematics: Kinematics,
}

impl SixD {
    /// The layout for a tree.
    pub fn new(kinematics: &Kinematics) -> Self {
        Self { kinematics: kinematics.clone() }
    }

    /// Parameters per frame.
    pub fn size(&self) -> usize {
        let k = &self.kinematics;
        (0..k.len()).map(|j| 6 * usize::from(k.turns[j]) + 3 * usize::from(k.slides[j])).sum()
    }

    /// Parameters of the rest pose.
    pub fn rest(&self) -> Vec<f64> {
        let k = &self.kinematics;
        let mut out = Vec::with_capacity(self.size());
        for j in 0..k.len() {
            if k.turns[j] {
                out.extend([1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
            }
            if k.slides[j] {
                out.extend([0.0; 3]);
            }
        }
        out
    }

    /// The pose that parameters stand for.
    pub fn pose(&self, parameters: &[f64]) -> FramePose {
        let k = &self.kinematics;
        let mut pose = k.rest();
        let mut rest = parameters;
        for j in 0..k.len() {
            if k.turns[j] {
                let (six, more) = rest.split_at(6);
                pose.rotations[j] = Frame::new(six).rotation();
                rest = more;
            }
            if k.slides[j] {
                let (three, more) = rest.split_at(3);
                pose.displacements[j] = DVec3::from_slice(three);
                rest = more;
            }
        }
        pose
    }

    /// ∂L/∂parameters from ∂L/∂increments (R ← R exp δ, t ← t + δt), as [`Kinematics::retract`] takes them.
    pub fn pullback(&self, parameters: &[f64], increments: &[f64]) -> Vec<f64> {
        let k = &self.kinematics;
        let mut out = Vec::with_capacity(self.size());
        for j in 0..k.len() {
            if let Some(o) = k.turn_offset[j] {
                let six = &parameters[out.len()..out.len() + 6];
                out.extend(Frame::new(six).pullback(DVec3::from_slice(&increments[o..o + 3])));
            }
            if let Some(o) = k.slide_offset[j] {
                out.extend_from_slice(&increments[o..o + 3]);
            }
        }
        out
    }
}

/// Two vectors on their way to a rotation.
struct Frame {
    first_length: f64,
    /// Length of the second one's part across the first.
    across: f64,
    /// The second one's part along the first.
    along: f64,
    b: [DVec3; 3],
}

impl Frame {
    fn new(six: &[f64]) -> Self {
        let (a1, a2) = (DVec3::from_slice(&six[..3]), DVec3::from_slice(&six[3..6]));
        let b1 = a1.normalize_or(DVec3::X);
        let along = b1.dot(a2);
        let u = a2 - b1 * along;
        let b2 = u.normalize_or(b1.any_orthonormal_vector());
        Self { first_length: a1.length().max(1e-12), across: u.length().max(1e-12), along, b: [b1, b2, b1.cross(b2)] }
    }

    fn rotation(&self) -> DMat3 {
        DMat3::from_cols(self.b[0], self.b[1], self.b[2])
    }

    /// With Rᵀ dR = \[δ\]ₓ: δ_z = b₂·db₁, δ_y = −b₃·db₁, δ_x = b₃·db₂.
    fn pullback(&self, g: DVec3) -> [f64; 6] {
        let [_, b2, b3] = self.b;
        let first = (b2 * g.z - b3 * g.y - b3 * (g.x * self.along / self.across)) / self.first_length;
        let second = b3 * (g.x / self.across);
        [first.x, first.y, first.z, second.x, second.y, second.z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};
    use animimic_rig::fixtures::creature;
    use animimic_rig::pose_vjp;
    use animimic_rig::solve_tree::SolveTree;

    #[test]
    fn forces_on_vertices_become_the_gradient_to_six_numbers_a_joint() {
        let (rig, mesh) = creature();
        let tree = SolveTree::new(&rig, &mesh);
        let kinematics = super::super::free(&tree.kinematics);
        let vertices = tree.vertex_anchors(&rig);
        let layout = SixD::new(&kinematics);
        let mut rng = SplitMix64(6);
        let x: Vec<f64> = layout.rest().iter().map(|v| v + 0.4 * rng.normal()).collect();
        let forces: Vec<DVec3> =
            vertices.iter().map(|_| DVec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
        let f = |x: &[f64]| -> f64 {
            let posed = kinematics.pose(&layout.pose(x));
            vertices.iter().zip(&forces).map(|(v, g)| v.position(&posed).dot(*g)).sum()
        };
        let increments = pose_vjp(&kinematics, &kinematics.pose(&layout.pose(&x)), &vertices, &forces);
        let error = gradient_error(f, &x, &layout.pullback(&x, &increments), 6, &[1e-3, 1e-4, 1e-5], 3);
        println!("relative error {error:.1e}");
        assert!(error < 1e-7);
        assert_eq!(layout.pose(&layout.rest()), kinematics.rest());
    }
}

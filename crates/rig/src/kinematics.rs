//! Forward kinematics in *rest-world displacements*.
//!
//! Every joint i carries a rigid displacement T_i from the rest pose: T_i = T_parent(i) · T(p_i + t_i) R_i T(−p_i), with p_i
//! the joint's rest position in world space, R_i a rotation about world axes at rest and t_i a translation. For rest
//! transforms G_i⁰ of the file the posed transform is G_i = T_i G_i⁰, so scaled joints need no special care: T_i is rigid.
//! Source: AniMimic §3.2 as restated in docs/method.md, "Rig"; increments R ← R exp(δ) instead of a 6D parametrisation.

use animimic_math::so3;
use glam::{DAffine3, DMat3, DVec3};

/// The tree along which joints move each other, reduced to what kinematics needs. Parents come first.
#[derive(Clone, Debug, Default)]
pub struct Kinematics {
    /// Parent joint, always smaller than the joint's own index; `None` for roots.
    pub parents: Vec<Option<usize>>,
    /// Rest positions of the joints, world space [model unit].
    pub pivots: Vec<DVec3>,
    /// Which joints may turn.
    pub turns: Vec<bool>,
    /// Which joints may be displaced.
    pub slides: Vec<bool>,
    /// First parameter of each joint's rotation increment in a frame's parameter vector, if it turns.
    pub turn_offset: Vec<Option<usize>>,
    /// First parameter of each joint's displacement, if it slides.
    pub slide_offset: Vec<Option<usize>>,
    /// Parameters per frame.
    pub dimension: usize,
}

/// Rotations and displacements of all joints in one frame: a point on SO(3)ᴶ × (ℝ³)ᴶ.
#[derive(Clone, Debug, PartialEq)]
pub struct FramePose {
    /// R_j \[joint\], world axes at rest.
    pub rotations: Vec<DMat3>,
    /// t_j \[joint\] [model unit], in the parent's displaced frame.
    pub displacements: Vec<DVec3>,
}

/// The result of forward kinematics for one frame.
#[derive(Clone, Debug)]
pub struct Posed {
    /// T_j, rigid displacement from rest \[joint\].
    pub transforms: Vec<DAffine3>,
    /// Posed joint positions \[joint\] [model unit].
    pub centers: Vec<DVec3>,
}

impl Kinematics {
    /// A tree with some freedoms; parameters are ordered by joint, rotation before displacement.
    pub fn new(parents: Vec<Option<usize>>, pivots: Vec<DVec3>, turns: Vec<bool>, slides: Vec<bool>) -> Self {
        let mut dimension = 0;
        let mut take = |wanted: bool| {
            wanted.then(|| {
                dimension += 3;
                dimension - 3
            })
        };
        let offsets: Vec<_> = turns.iter().zip(&slides).map(|(&t, &s)| (take(t), take(s))).collect();
        let (turn_offset, slide_offset) = offsets.into_iter().unzip();
        Self { parents, pivots, turns, slides, turn_offset, slide_offset, dimension }
    }

    /// Appends a joint without parent that neither turns nor slides: it holds what does not move.
    pub fn push_fixed(&mut self, pivot: DVec3) {
        self.parents.push(None);
        self.pivots.push(pivot);
        self.turns.push(false);
        self.slides.push(false);
        self.turn_offset.push(None);
        self.slide_offset.push(None);
    }

    /// Number of joints.
    pub fn len(&self) -> usize {
        self.parents.len()
    }

    /// Whether there is no joint.
    pub fn is_empty(&self) -> bool {
        self.parents.is_empty()
    }

    /// The rest pose.
    pub fn rest(&self) -> FramePose {
        FramePose { rotations: vec![DMat3::IDENTITY; self.len()], displacements: vec![DVec3::ZERO; self.len()] }
    }

    /// Forward kinematics.
    pub fn pose(&self, frame: &FramePose) -> Posed {
        let mut transforms: Vec<DAffine3> = Vec::with_capacity(self.len());
        let mut centers = Vec::with_capacity(self.len());
        for j in 0..self.len() {
            let (r, p) = (frame.rotations[j], self.pivots[j]);
            let moved = p + frame.displacements[j];
            let local = DAffine3::from_mat3_translation(r, moved - r * p);
            let parent = self.parents[j].map_or(DAffine3::IDENTITY, |q| transforms[q]);
            centers.push(parent.transform_point3(moved));
            transforms.push(parent * local);
        }
        Posed { transforms, centers }
    }

    /// Rotation of the frame in which joint j's displacement is expressed: its parent's.
    pub fn slide_axes(&self, posed: &Posed, joint: usize) -> DMat3 {
        self.parents[joint].map_or(DMat3::IDENTITY, |p| posed.transforms[p].matrix3)
    }

    /// Moves a pose along an increment: R_j ← R_j exp(δ_j), t_j ← t_j + δt_j. `step` \[dimension\].
    pub fn retract(&self, frame: &FramePose, step: &[f64]) -> FramePose {
        let mut moved = frame.clone();
        for j in 0..self.len() {
            if let Some(o) = self.turn_offset[j] {
                let delta = DVec3::new(step[o], step[o + 1], step[o + 2]);
                moved.rotations[j] = so3::orthonormalized(&(moved.rotations[j] * so3::exp(delta)));
            }
            if let Some(o) = self.slide_offset[j] {
                moved.displacements[j] += DVec3::new(step[o], step[o + 1], step[o + 2]);
            }
        }
        moved
    }

    /// The increment that leads from `from` to `to` (inverse of [`Self::retract`]).
    pub fn difference(&self, from: &FramePose, to: &FramePose) -> Vec<f64> {
        let mut step = vec![0.0; self.dimension];
        for j in 0..self.len() {
            if let Some(o) = self.turn_offset[j] {
                let w = so3::log(&(from.rotations[j].transpose() * to.rotations[j]));
                step[o..o + 3].copy_from_slice(&w.to_array());
            }
            if let Some(o) = self.slide_offset[j] {
                step[o..o + 3].copy_from_slice(&(to.displacements[j] - from.displacements[j]).to_array());
            }
        }
        step
    }

    /// Whether `ancestor` is `joint` or above it.
    pub fn is_ancestor(&self, ancestor: usize, joint: usize) -> bool {
        let mut at = Some(joint);
        while let Some(j) = at {
            if j == ancestor {
                return true;
            }
            at = self.parents[j];
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::creature;
    use crate::solve_tree::SolveTree;
    use animimic_math::gradcheck::SplitMix64;

    #[test]
    fn difference_inverts_retract() {
        let (rig, mesh) = creature();
        let tree = SolveTree::new(&rig, &mesh).kinematics;
        let mut rng = SplitMix64(4);
        let mut step = || -> Vec<f64> { (0..tree.dimension).map(|_| 0.6 * rng.normal()).collect() };
        let from = tree.retract(&tree.rest(), &step());
        let wanted = step();
        let found = tree.difference(&from, &tree.retract(&from, &wanted));
        let worst = wanted.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("largest difference {worst:.1e}");
        assert!(worst < 1e-12);
    }

    #[test]
    fn a_chain_turned_at_its_root_moves_rigidly() {
        let pivots = vec![DVec3::X, DVec3::new(1.0, 1.0, 0.0)];
        let tree = Kinematics::new(vec![None, Some(0)], pivots, vec![true; 2], vec![true, false]);
        let quarter = std::f64::consts::FRAC_PI_2;
        let posed = tree.pose(&tree.retract(&tree.rest(), &[0.0, 0.0, quarter, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]));
        assert!(posed.centers[1].abs_diff_eq(DVec3::new(0.0, 0.0, 2.0), 1e-14), "{}", posed.centers[1]);
        assert!(posed.transforms[1].abs_diff_eq(posed.transforms[0], 1e-14));
    }
}

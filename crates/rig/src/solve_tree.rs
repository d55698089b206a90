//! From a file's skeleton to the tree that is solved, and back.
//!
//! Files hang joints in ways that suit an animation tool rather than anatomy: IK feet beside the armature, control bones
//! without weights, chains of roots. For solving,
//! * only joints that move vertices, and what lies between them, take part;
//! * a subtree whose geometry hangs on a bone far from its own parent (an IK foot) is *tied* to that bone, against which it
//!   may slide a little; what holds most of the body is never tied to a limb;
//! * the root is the deepest joint above (nearly) all weight; it alone is displaced freely;
//! * parts that touch nothing (floating hands) may slide against their parent.
//!
//! The way back writes each joint's own local transform, so the file's hierarchy is untouched.

use crate::anchor::Anchor;
use crate::kinematics::{FramePose, Kinematics};
use animimic_math::so3;
use animimic_scene::{Mesh, Pose, Rig, Transform};
use glam::{DAffine3, DQuat};

/// A root must carry this share of all weight: what lies above it holds only stray weights.
const ROOT_WEIGHT_SHARE: f64 = 0.99;
/// A subtree with at least this share of its boundary on its own ancestors is attached where the file says.
const ATTACHED_BOUNDARY_SHARE: f64 = 0.25;
/// A part farther than this from all others floats [rest diagonal].
const FLOATING_GAP: f64 = 0.01;

/// The solved tree with its maps to and from the file's skeleton.
#[derive(Clone, Debug)]
pub struct SolveTree {
    /// The tree that is solved. Where joints outside it carry weight its last joint is fixed, and holds what they hold.
    pub kinematics: Kinematics,
    /// Skeleton joint → joint of `kinematics` that carries it, or `None` where it stays at rest.
    pub joint_of: Vec<Option<usize>>,
    /// Joint of `kinematics` → skeleton joint.
    pub skeleton_joint: Vec<usize>,
    /// Skeleton joints whose geometry hung elsewhere, with the skeleton joint they were tied to.
    pub ties: Vec<(usize, usize)>,
    /// Rest transforms of the skeleton, world space.
    pub rest_world: Vec<DAffine3>,
}

impl SolveTree {
    /// Analyses a rig. `mesh` gives connectivity and the rest diagonal.
    pub fn new(rig: &Rig, mesh: &Mesh) -> Self {
        let geometry = Geometry::new(rig, mesh);
        let count = rig.skeleton.joints.len();
        let mut parents: Vec<Option<usize>> = rig.skeleton.joints.iter().map(|j| j.parent).collect();
        let ties = geometry.tie(&mut parents);
        let order = topological(&parents);
        let live = live_joints(&parents, &order, &geometry.weight);
        let root = solve_root(&parents, &order, &geometry.weight, &live);

        let rest_world = rig.skeleton.rest_world();
        let mut joint_of = vec![None; count];
        let mut skeleton_joint = Vec::new();
        for &j in &order {
            let below_root = root.is_none_or(|r| is_below(&parents, j, r));
            if live[j] && below_root {
                joint_of[j] = Some(skeleton_joint.len());
                skeleton_joint.push(j);
            }
        }
        let solve_parents: Vec<Option<usize>> =
            skeleton_joint.iter().map(|&j| parents[j].and_then(|p| joint_of[p])).collect();
        let slides = skeleton_joint
            .iter()
            .zip(&solve_parents)
            .map(|(&j, parent)| parent.is_none() || ties.iter().any(|t| t.0 == j) || geometry.floats(&parents, j))
            .collect();
        let pivots = skeleton_joint.iter().map(|&j| rest_world[j].translation).collect();
        let turns = vec![true; skeleton_joint.len()];
        // Joints that carry nothing themselves still follow the joint above them.
        for &j in &order {
            if joint_of[j].is_none() {
                joint_of[j] = parents[j].and_then(|p| joint_of[p]);
            }
        }
        let mut tree = Kinematics::new(solve_parents, pivots, turns, slides);
        let fixed = (0..count).find(|&j| joint_of[j].is_none() && geometry.weight[j] > 0.0);
        if let Some(j) = fixed {
            skeleton_joint.push(j);
            tree.push_fixed(rest_world[j].translation);
        }
        Self { kinematics: tree, joint_of, skeleton_joint, ties, rest_world }
    }

    /// The anchor of every vertex of the mesh.
    pub fn vertex_anchors(&self, rig: &Rig) -> Vec<Anchor> {
        // What joints above the root hold stays where it is: the last joint is fixed where there are such weights.
        let fixed = self.kinematics.len().saturating_sub(1);
        let joint_of: Vec<usize> = self.joint_of.iter().map(|j| j.unwrap_or(fixed)).collect();
        let rest: Vec<DAffine3> = rig.skin.slots.iter().map(|s| self.rest_world[s.joint] * s.inverse_bind).collect();
        (0..rig.skin.influences.len()).map(|v| Anchor::vertex(&rig.skin, &rest, &joint_of, v)).collect()
    }

    /// The file's pose for a solved frame: local transforms of every skeleton joint.
    pub fn pose(&self, rig: &Rig, frame: &FramePose) -> Pose {
        let posed = self.kinematics.pose(frame);
        let displacement = |j: usize| self.joint_of[j].map_or(DAffine3::IDENTITY, |k| posed.transforms[k]);
        let locals = rig.skeleton.joints.iter().enumerate().map(|(j, joint)| {
            let (own, above) = (displacement(j), joint.parent.map_or(DAffine3::IDENTITY, displacement));
            let rest_above = joint.parent.map_or(DAffine3::IDENTITY, |p| self.rest_world[p]);
            if own == above { joint.rest } else { displaced(&joint.rest, above.inverse() * own, rest_above) }
        });
        Pose { locals: locals.collect() }
    }

    /// The solved frame of a file's pose: the opposite of [`SolveTree::pose`], exact for poses that it made. What the tree has no freedom
    /// for (other translations, scales) is left out.
    pub fn frame(&self, rig: &Rig, pose: &Pose) -> FramePose {
        let world = rig.skeleton.world_from_joint(&pose.locals);
        let kinematics = &self.kinematics;
        let mut frame = kinematics.rest();
        let mut transforms: Vec<DAffine3> = Vec::with_capacity(kinematics.len());
        for (k, &j) in self.skeleton_joint.iter().enumerate() {
            let above = kinematics.parents[k].map_or(DAffine3::IDENTITY, |p| transforms[p]);
            let own = world[j] * self.rest_world[j].inverse();
            let (moves, pivot) = (kinematics.turns[k] && own.is_finite(), kinematics.pivots[k]);
            let local = if moves { above.inverse() * own } else { DAffine3::IDENTITY };
            frame.rotations[k] = so3::orthonormalized(&local.matrix3);
            if kinematics.slides[k] {
                frame.displacements[k] = local.transform_point3(pivot) - pivot;
            }
            let shift = pivot + frame.displacements[k] - frame.rotations[k] * pivot;
            transforms.push(above * DAffine3::from_mat3_translation(frame.rotations[k], shift));
        }
        frame
    }
}

/// A joint's local transform after a rigid displacement relative to its parent, which is given in rest-world space:
/// G_p⁻¹ D G_p · (T R S). Exact where the parent's rest transform is a similarity; shear under parents with unequal scales cannot
/// be written as T R S, and the nearest rotation is taken.
fn displaced(rest: &Transform, displacement: DAffine3, rest_above: DAffine3) -> Transform {
    let local = rest_above.inverse() * displacement * rest_above;
    if !local.is_finite() {
        return *rest;
    }
    let turn = DQuat::from_mat3(&so3::orthonormalized(&local.matrix3));
    Transform {
        translation: local.transform_point3(rest.translation),
        rotation: (turn * rest.rotation).normalize(),
        scale: rest.scale,
    }
}

/// What the skin says about where joints' geometry lies and touches.
struct Geometry<'a> {
    rig: &'a Rig,
    mesh: &'a Mesh,
    /// Total weight \[joint\].
    weight: Vec<f64>,
    /// Joint with the largest weight \[vertex\].
    owner: Vec<usize>,
    /// Number of mesh edges between the geometry of two joints, [a][b].
    shared_edges: Vec<Vec<usize>>,
}

impl<'a> Geometry<'a> {
    fn new(rig: &'a Rig, mesh: &'a Mesh) -> Self {
        let count = rig.skeleton.joints.len();
        let mut weight = vec![0.0; count];
        let mut owner = Vec::with_capacity(rig.skin.influences.len());
        for influences in &rig.skin.influences {
            let mut per_joint: Vec<(usize, f64)> = Vec::with_capacity(influences.len());
            for i in influences {
                let joint = rig.skin.slots[i.slot as usize].joint;
                weight[joint] += i.weight;
                match per_joint.iter_mut().find(|(j, _)| *j == joint) {
                    Some((_, w)) => *w += i.weight,
                    None => per_joint.push((joint, i.weight)),
                }
            }
            owner.push(per_joint.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |p| p.0));
        }
        let mut welded_owner = vec![0; mesh.welded_count];
        for (v, &w) in mesh.welded.iter().enumerate() {
            welded_owner[w as usize] = owner[v];
        }
        let mut shared_edges = vec![vec![0; count]; count];
        for t in &mesh.triangles {
            for k in 0..3 {
                let a = welded_owner[mesh.welded[t[k] as usize] as usize];
                let b = welded_owner[mesh.welded[t[(k + 1) % 3] as usize] as usize];
                if a != b {
                    shared_edges[a][b] += 1;
                    shared_edges[b][a] += 1;
                }
            }
        }
        Self { rig, mesh, weight, owner, shared_edges }
    }

    /// Re-parents detached subtrees; returns (subtree head, joint it was tied to).
    fn tie(&self, parents: &mut [Option<usize>]) -> Vec<(usize, usize)> {
        let mut ties = Vec::new();
        let total: f64 = self.weight.iter().sum();
        for head in 0..parents.len() {
            let Some(parent) = parents[head] else { continue };
            // Only a joint that hangs on one without weight of its own near it can be detached.
            let inside: Vec<bool> = (0..parents.len()).map(|j| is_below(parents, j, head)).collect();
            let within: f64 = inside.iter().zip(&self.weight).filter(|(i, _)| **i).map(|(_, w)| w).sum();
            // Limbs hang on the body, not the body on a limb.
            if within == 0.0 || within > 0.5 * total {
                continue;
            }
            let Some((attached, ancestor_share)) = self.attachment(parents, head, &inside) else { continue };
            let above = is_below(parents, head, attached);
            let levels = levels_below_common(parents, attached, parent);
            if !above && ancestor_share < ATTACHED_BOUNDARY_SHARE && levels >= 2 {
                parents[head] = Some(attached);
                ties.push((head, attached));
            }
        }
        ties
    }

    /// The outside joint on which a subtree's geometry hangs most, and the share of its boundary that lies on its ancestors.
    fn attachment(&self, parents: &[Option<usize>], head: usize, inside: &[bool]) -> Option<(usize, f64)> {
        let outside: Vec<usize> = (0..parents.len()).filter(|&j| !inside[j]).collect();
        let edges =
            |b: usize| -> usize { (0..parents.len()).filter(|&a| inside[a]).map(|a| self.shared_edges[a][b]).sum() };
        let counts: Vec<(usize, usize)> = outside.iter().map(|&b| (b, edges(b))).filter(|c| c.1 > 0).collect();
        if counts.is_empty() {
            let (joint, _) = self.nearest_geometry(inside)?;
            let above = is_below(parents, head, joint);
            return Some((joint, if above { 1.0 } else { 0.0 }));
        }
        let total: usize = counts.iter().map(|c| c.1).sum();
        let on_ancestors: usize = counts.iter().filter(|c| is_below(parents, head, c.0)).map(|c| c.1).sum();
        let (joint, _) = counts.into_iter().max_by_key(|c| (c.1, usize::MAX - c.0))?;
        Some((joint, on_ancestors as f64 / total as f64))
    }

    /// The joint outside with the vertex nearest to the geometry inside, and that distance [model unit].
    fn nearest_geometry(&self, inside: &[bool]) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        let (within, without): (Vec<usize>, Vec<usize>) = (0..self.owner.len()).partition(|&v| inside[self.owner[v]]);
        // A sample is enough to tell which limb a part belongs to.
        let step_in = within.len() / 300 + 1;
        let step_out = without.len() / 3000 + 1;
        for &a in within.iter().step_by(step_in) {
            for &b in without.iter().step_by(step_out) {
                let d = self.mesh.positions[a].distance(self.mesh.positions[b]);
                if best.is_none_or(|(_, closest)| d < closest) {
                    best = Some((self.owner[b], d));
                }
            }
        }
        best
    }

    /// Whether the geometry below a joint touches nothing else.
    fn floats(&self, parents: &[Option<usize>], joint: usize) -> bool {
        let inside: Vec<bool> = (0..parents.len()).map(|j| is_below(parents, j, joint)).collect();
        if self.weight[joint] == 0.0 && self.rig.skeleton.joints[joint].parent.is_some() {
            return false;
        }
        let connected = (0..parents.len())
            .filter(|&a| inside[a])
            .any(|a| (0..parents.len()).any(|b| !inside[b] && self.shared_edges[a][b] > 0));
        !connected && self.nearest_geometry(&inside).is_some_and(|(_, gap)| gap > FLOATING_GAP * self.mesh.diagonal())
    }
}

fn is_below(parents: &[Option<usize>], joint: usize, ancestor: usize) -> bool {
    let mut at = Some(joint);
    while let Some(j) = at {
        if j == ancestor {
            return true;
        }
        at = parents[j];
    }
    false
}

/// How many levels `joint` lies below the lowest ancestor that it shares with `other`.
fn levels_below_common(parents: &[Option<usize>], joint: usize, other: usize) -> usize {
    let mut levels = 0;
    let mut at = Some(joint);
    while let Some(j) = at {
        if is_below(parents, other, j) {
            return levels;
        }
        levels += 1;
        at = parents[j];
    }
    levels
}

/// Joints with parents first; needed again after ties changed parents.
fn topological(parents: &[Option<usize>]) -> Vec<usize> {
    let depth = |j: usize| {
        let (mut d, mut at) = (0, parents[j]);
        while let Some(p) = at {
            d += 1;
            at = parents[p];
        }
        d
    };
    let mut order: Vec<usize> = (0..parents.len()).collect();
    order.sort_by_key(|&j| (depth(j), j));
    order
}

/// Joints that carry weight themselves or through a descendant.
fn live_joints(parents: &[Option<usize>], order: &[usize], weight: &[f64]) -> Vec<bool> {
    let mut live: Vec<bool> = weight.iter().map(|&w| w > 1e-6).collect();
    for &j in order.iter().rev() {
        if live[j]
            && let Some(p) = parents[j]
        {
            live[p] = true;
        }
    }
    live
}

/// The deepest joint that has (nearly) all weight at or below it; `None` if there are several top joints.
fn solve_root(parents: &[Option<usize>], order: &[usize], weight: &[f64], live: &[bool]) -> Option<usize> {
    let mut below = weight.to_vec();
    for &j in order.iter().rev() {
        if let Some(p) = parents[j] {
            below[p] += below[j];
        }
    }
    let total: f64 = weight.iter().sum();
    let mut root = None;
    for &j in order {
        if live[j] && below[j] >= ROOT_WEIGHT_SHARE * total {
            root = Some(j);
        }
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{creature, creature_with_stray_weight, joint};
    use animimic_math::gradcheck::SplitMix64;
    use animimic_scene::Asset;

    fn random_pose(tree: &SolveTree, seed: u64) -> FramePose {
        let mut rng = SplitMix64(seed);
        let step: Vec<f64> = (0..tree.kinematics.dimension).map(|_| 0.5 * rng.normal()).collect();
        tree.kinematics.retract(&tree.kinematics.rest(), &step)
    }

    /// Largest distance between the anchors' positions and the file's own skinning of the file's pose, per rest diagonal.
    fn round_trip_error(rig: &Rig, mesh: &Mesh, seed: u64) -> f64 {
        let tree = SolveTree::new(rig, mesh);
        let frame = random_pose(&tree, seed);
        let posed = tree.kinematics.pose(&frame);
        let skinned = rig.in_pose(&tree.pose(rig, &frame));
        let anchors = tree.vertex_anchors(rig);
        let worst = anchors.iter().zip(&skinned).map(|(a, x)| a.position(&posed).distance(*x)).fold(0.0, f64::max);
        worst / mesh.diagonal()
    }

    #[test]
    fn the_rest_pose_gives_the_files_rest_bit_for_bit() {
        for (rig, mesh) in [creature(), creature_with_stray_weight()] {
            let tree = SolveTree::new(&rig, &mesh);
            assert_eq!(tree.pose(&rig, &tree.kinematics.rest()).locals, rig.skeleton.rest_locals());
        }
    }

    #[test]
    fn a_files_pose_that_was_solved_is_the_same_frame_again() {
        for (rig, mesh) in [creature(), creature_with_stray_weight()] {
            let tree = SolveTree::new(&rig, &mesh);
            let frame = random_pose(&tree, 9);
            let step = tree.kinematics.difference(&tree.frame(&rig, &tree.pose(&rig, &frame)), &frame);
            let worst = step.iter().fold(0.0f64, |m, s| m.max(s.abs()));
            println!("off by {worst:.1e}");
            assert!(worst < 1e-9);
        }
    }

    #[test]
    fn the_files_skinning_of_a_solved_pose_equals_the_anchors() {
        for (rig, mesh) in [creature(), creature_with_stray_weight()] {
            for seed in 1..6 {
                let error = round_trip_error(&rig, &mesh, seed);
                println!("seed {seed}: {error:.1e} of the diagonal");
                assert!(error < 1e-9);
            }
        }
    }

    #[test]
    fn the_creature_is_tied_rooted_and_slid_as_designed() {
        let (rig, mesh) = creature();
        let tree = SolveTree::new(&rig, &mesh);
        assert_eq!(tree.ties, [(joint::FOOT, joint::SHIN)]);
        let sliding: Vec<usize> =
            (0..tree.kinematics.len()).filter(|&j| tree.kinematics.slides[j]).map(|j| tree.skeleton_joint[j]).collect();
        // A tied foot is moved by other means in the file, so it need not stay at the end of its shin.
        assert_eq!(sliding, [joint::ARMATURE, joint::PROP, joint::HIP, joint::THIGH, joint::HAND, joint::FOOT]);
        assert_eq!(tree.joint_of[joint::MARKER], tree.joint_of[joint::CHEST], "it follows the chest");
    }

    #[test]
    fn what_joints_above_the_root_hold_stays_at_rest() {
        let (mut rig, mesh) = creature_with_stray_weight();
        let tree = SolveTree::new(&rig, &mesh);
        assert_eq!(tree.joint_of[joint::ARMATURE], None);
        let fixed = tree.kinematics.len() - 1;
        assert!(!tree.kinematics.turns[fixed] && !tree.kinematics.slides[fixed]);
        // All of a vertex on the joint above: it does not move, whatever the pose.
        rig.skin.influences[0].truncate(1);
        rig.skin.influences[0][0].weight = 1.0;
        let posed = tree.kinematics.pose(&random_pose(&tree, 9));
        let moved = tree.vertex_anchors(&rig)[0].position(&posed).distance(mesh.positions[0]);
        println!("moved by {moved:.1e}");
        assert!(moved < 1e-12);
    }

    #[test]
    fn shared_rigs_come_back_as_the_anchors_have_them() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/gt");
        let Ok(entries) = std::fs::read_dir(folder) else {
            println!("skipped: {folder} is absent");
            return;
        };
        let mut cases: Vec<_> = entries.flatten().map(|e| e.path().join("static.glb")).filter(|p| p.exists()).collect();
        cases.sort();
        for path in cases {
            let Asset { rig, mesh, .. } = animimic_scene::io::read(&path).expect("a readable model");
            let error = round_trip_error(&rig, &mesh, 3);
            // Shear below unequal scales cannot be written as T R S: the error may be of their order, and no more.
            let uneven = unevenness(&rig);
            println!("{}: {error:.1e} of the diagonal, scales uneven by {uneven:.1e}", path.display());
            assert!(error < 1e-9 + 4.0 * uneven, "{}", path.display());
        }
    }

    /// Largest relative difference between the axes' scales of any joint that has children; 0 up to rounding in f64.
    fn unevenness(rig: &Rig) -> f64 {
        let world = rig.skeleton.rest_world();
        let uneven = |p: usize| {
            let m = world[p].matrix3;
            let lengths = [m.x_axis, m.y_axis, m.z_axis].map(|a| a.length());
            let (lo, hi) = lengths.iter().fold((f64::INFINITY, 0.0f64), |(lo, hi), &l| (lo.min(l), hi.max(l)));
            let difference = (hi - lo) / hi;
            if difference < 1e-14 { 0.0 } else { difference }
        };
        rig.skeleton.joints.iter().filter_map(|j| j.parent).map(uneven).fold(0.0, f64::max)
    }
}

//! From a file's skeleton to the tree that is solved, and back.
//!
//! Files hang joints in ways that suit an animation tool rather than anatomy: IK feet beside the armature, control bones
//! without weights, chains of roots. For solving,
//! * only joints that move vertices, and what lies between them, take part;
//! * a subtree whose geometry hangs on a bone far from its own parent (an IK foot) is *tied* to that bone;
//! * the root is the deepest joint above (nearly) all weight; it alone is displaced freely;
//! * parts that touch nothing (floating hands) may slide against their parent.
//!
//! The way back writes each joint's own local transform, so the file's hierarchy is untouched.

use crate::anchor::Anchor;
use crate::kinematics::{FramePose, Kinematics};
use animimic_scene::{Mesh, Pose, Rig, Transform};
use glam::DAffine3;

/// A root must carry this share of all weight: what lies above it holds only stray weights.
const ROOT_WEIGHT_SHARE: f64 = 0.99;
/// A subtree with at least this share of its boundary on its own ancestors is attached where the file says.
const ATTACHED_BOUNDARY_SHARE: f64 = 0.25;
/// A part farther than this from all others floats [rest diagonal].
const FLOATING_GAP: f64 = 0.01;

/// The solved tree with its maps to and from the file's skeleton.
#[derive(Clone, Debug)]
pub struct SolveTree {
    /// The tree that is solved.
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

        let rest_world = rig.skeleton.world_from_joint(&rig.skeleton.rest_locals());
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
            .map(|(&j, parent)| parent.is_none() || geometry.floats(&parents, j))
            .collect();
        let pivots = skeleton_joint.iter().map(|&j| rest_world[j].translation).collect();
        let turns = vec![true; skeleton_joint.len()];
        // Joints that carry nothing themselves still follow the joint above them.
        for &j in &order {
            if joint_of[j].is_none() {
                joint_of[j] = parents[j].and_then(|p| joint_of[p]);
            }
        }
        let kinematics = Kinematics::new(solve_parents, pivots, turns, slides);
        Self { kinematics, joint_of, skeleton_joint, ties, rest_world }
    }

    /// The anchor of every vertex of the mesh.
    pub fn vertex_anchors(&self, rig: &Rig) -> Vec<Anchor> {
        // Vertices of joints above the root do not move: they hang on a static extra joint, which is left out of the shares
        // by giving its weight to the root instead.
        let joint_of: Vec<usize> = self.joint_of.iter().map(|j| j.unwrap_or(0)).collect();
        let rest: Vec<DAffine3> =
            rig.skin.slots.iter().map(|s| self.rest_world[s.joint] * s.inverse_bind).collect();
        (0..rig.skin.influences.len()).map(|v| Anchor::vertex(&rig.skin, &rest, &joint_of, v)).collect()
    }

    /// The file's pose for a solved frame: local transforms of every skeleton joint.
    pub fn pose(&self, rig: &Rig, frame: &FramePose) -> Pose {
        let posed = self.kinematics.pose(frame);
        let joints = &rig.skeleton.joints;
        let root_weightless = |j: usize| self.joint_of[j].is_none();
        let world: Vec<DAffine3> = (0..joints.len())
            .map(|j| self.joint_of[j].map_or(self.rest_world[j], |k| posed.transforms[k] * self.rest_world[j]))
            .collect();
        let locals = joints
            .iter()
            .enumerate()
            .map(|(j, joint)| {
                let follows_parent = match joint.parent {
                    Some(p) => self.joint_of[j] == self.joint_of[p],
                    None => root_weightless(j),
                };
                if follows_parent {
                    return joint.rest;
                }
                let parent = joint.parent.map_or(DAffine3::IDENTITY, |p| world[p]);
                let local = Transform::from_affine(parent.inverse() * world[j]);
                // Displacements are rigid: the scale is the rest's own, free of rounding.
                Transform { scale: joint.rest.scale, ..local }
            })
            .collect();
        Pose { locals }
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
        for head in 0..parents.len() {
            let Some(parent) = parents[head] else { continue };
            // Only a joint that hangs on one without weight of its own near it can be detached.
            let inside: Vec<bool> = (0..parents.len()).map(|j| is_below(parents, j, head)).collect();
            if !inside.iter().zip(&self.weight).any(|(&i, &w)| i && w > 0.0) {
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
        let (within, without): (Vec<usize>, Vec<usize>) =
            (0..self.owner.len()).partition(|&v| inside[self.owner[v]]);
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

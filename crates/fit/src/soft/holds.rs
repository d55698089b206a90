//! How joints hold a cage.
//!
//! A bone holds the flesh in its core: points along it and on a ring around it are tethered to the joint's rigid displacement.
//! The ring's radius is a share of the flesh's thickness and shrinks towards joints, next to which nothing is held. No tet is
//! held by two joints, so none is torn between them. Small hard parts (eyes, buttons) are driven whole.

use super::bones::Bone;
use super::weights::CageWeights;
use animimic_scene::TetMesh;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Share of the flesh around a bone that goes with it.
const CORE: f64 = 0.5;
/// Distance between held points along a bone, and around it [cells].
const STEP: f64 = 0.5;
/// Nothing is held nearer to a joint than this [cells], or than the second share of the bone's length, whichever is less.
const FREE_ENDS: [f64; 2] = [0.75, 0.35];
/// A wider core than this has a second ring half way in [cells].
const WIDE: f64 = 1.0;
/// Least weight of the joint where it holds.
const OWN: f64 = 0.5;
/// Least share of loose joints in what counts as the root of loose flesh.
const SEAM: f64 = 0.05;
/// Components with less than this share of the body's volume, all of them one joint's, are hard: eyes, buttons, teeth.
const SMALL: f64 = 0.02;
/// Least weight of the joint everywhere in such a component.
const ALL_OF_IT: f64 = 0.9;

/// No joint drives this vertex.
pub const FREE: u32 = u32::MAX;

/// What holds are chosen from.
pub struct Choice<'a> {
    /// The cage.
    pub mesh: &'a TetMesh,
    /// Side of its cells [model unit].
    pub spacing: f64,
    /// Weights at its vertices.
    pub weights: &'a CageWeights,
    /// Bones of the joints.
    pub bones: &'a [Bone],
    /// Joints (indices into the weights' joints) that hold nothing.
    pub loose: &'a [bool],
}

/// A point of the flesh that a joint holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// The joint, as an index into the weights' joints.
    pub joint: u32,
    /// The tet, and where in it.
    pub tet: u32,
    /// Barycentric coordinates in the tet.
    pub barycentric: [f64; 4],
    /// The point at rest [model unit].
    pub point: DVec3,
}

/// Points held by joints, and the driving joint of every cage vertex (an index into the weights' joints, or [`FREE`]).
pub fn holds(choice: &Choice) -> (Vec<Hold>, Vec<u32>) {
    let grid = Grid::new(choice);
    let points: Vec<(usize, DVec3)> = choice
        .bones
        .iter()
        .filter(|b| !choice.loose[b.joint])
        .flat_map(|b| core(b, choice.spacing).into_iter().map(|p| (b.joint, p)))
        .collect();
    let mut holds: Vec<Hold> = points.par_iter().filter_map(|&(joint, p)| grid.hold(choice, joint, p)).collect();
    at_least_one_each(choice, &mut holds);
    let driver = components(choice, &mut holds);
    (part(choice, holds), driver)
}

/// Points in the core of a bone.
fn core(bone: &Bone, spacing: f64) -> Vec<DVec3> {
    let [a, b] = bone.ends;
    let length = a.distance(b);
    let free = (FREE_ENDS[0] * spacing).min(FREE_ENDS[1] * length);
    let from = if bone.jointed[0] { free } else { 0.0 };
    let to = if bone.jointed[1] { length - free } else { length };
    let count = ((to - from) / (STEP * spacing)).ceil().max(1.0) as usize;
    let axis = (b - a).try_normalize().unwrap_or(DVec3::X);
    let (u, v) = axis.any_orthonormal_pair();
    let mut points = Vec::new();
    for k in 0..count {
        let center = a + axis * (from + (to - from) * (k as f64 + 0.5) / count as f64);
        let here = bone.beside(center);
        let narrow = (here.to_joint / (here.thickness + STEP * spacing)).min(1.0);
        let radius = CORE * here.thickness * narrow;
        points.push(center);
        let rings = if radius > WIDE * spacing { vec![0.5 * radius, radius] } else { vec![radius] };
        for r in rings {
            let around = (TAU * r / (STEP * spacing)).ceil().clamp(4.0, 16.0);
            points.extend((0..around as usize).map(|n| {
                let (s, c) = (TAU * n as f64 / around).sin_cos();
                center + (u * c + v * s) * r
            }));
        }
    }
    points
}

/// A joint whose bones lie outside the flesh holds the vertex that is most its own.
fn at_least_one_each(choice: &Choice, holds: &mut Vec<Hold>) {
    for joint in (0..choice.weights.joints.len()).filter(|&j| !choice.loose[j]) {
        if holds.iter().any(|h| h.joint as usize == joint) {
            continue;
        }
        let score = |v: usize| {
            let x = choice.mesh.positions[v];
            let near = choice.bones.iter().filter(|b| b.joint == joint).map(|b| b.beside(x).distance);
            choice.weights.rows[v][joint] - 0.25 * near.fold(f64::INFINITY, f64::min) / choice.spacing
        };
        let own = (0..choice.mesh.positions.len())
            .filter(|&v| choice.weights.main(v).0 == joint && choice.weights.rows[v][joint] >= OWN);
        let best = own.max_by(|&a, &b| score(a).total_cmp(&score(b)).then(b.cmp(&a)));
        holds.extend(best.and_then(|v| at_vertex(choice.mesh, joint, v as u32)));
    }
}

/// A hold at a vertex of the cage.
pub(super) fn at_vertex(mesh: &TetMesh, joint: usize, v: u32) -> Option<Hold> {
    let tet = mesh.tets.iter().position(|t| t.contains(&v))?;
    let barycentric = mesh.tets[tet].map(|k| f64::from(u8::from(k == v)));
    Some(Hold { joint: joint as u32, tet: tet as u32, barycentric, point: mesh.positions[v as usize] })
}

/// Vertices at the roots of loose flesh: those that belong to loose joints by some share, but less than half. They follow the skin,
/// so that what the first loose joint does where it meets the body carries over into what hangs on it.
pub fn seams(choice: &Choice, driver: &[u32]) -> Vec<u32> {
    let share = |v: usize| -> f64 {
        let row = choice.weights.rows[v].iter().zip(choice.loose);
        row.filter(|(_, loose)| **loose).map(|(w, _)| w).sum()
    };
    let root = |v: &u32| driver[*v as usize] == FREE && (SEAM..OWN).contains(&share(*v as usize));
    (0..choice.mesh.positions.len() as u32).filter(root).collect()
}

/// Leaves to every tet the holds of one joint: the one whose it is most.
fn part(choice: &Choice, holds: Vec<Hold>) -> Vec<Hold> {
    let mut best = vec![(0.0, FREE); choice.mesh.tets.len()];
    for h in &holds {
        let weight = weight(choice, h.joint as usize, h.tet as usize, &[0.25; 4]);
        let b = &mut best[h.tet as usize];
        if b.1 == FREE || weight > b.0 || (weight == b.0 && h.joint < b.1) {
            *b = (weight, h.joint);
        }
    }
    holds.into_iter().filter(|h| best[h.tet as usize].1 == h.joint).collect()
}

/// The weight of a joint at a point of a tet.
fn weight(choice: &Choice, joint: usize, tet: usize, barycentric: &[f64; 4]) -> f64 {
    let corners = choice.mesh.tets[tet].iter().zip(barycentric);
    corners.map(|(&v, b)| choice.weights.rows[v as usize][joint] * b).sum()
}

/// Tets by the cube of space that their centre lies in, for finding those around a point.
struct Grid {
    lowest: DVec3,
    side: f64,
    size: [usize; 3],
    tets: Vec<Vec<u32>>,
}

impl Grid {
    fn new(choice: &Choice) -> Self {
        let (lowest, highest) = animimic_scene::mesh::bounds(&choice.mesh.positions);
        // A tet reaches no farther than one side from its centre.
        let side = choice.spacing;
        let size = ((highest - lowest) / side).to_array().map(|n| n as usize + 1);
        let mut grid = Self { lowest, side, size, tets: vec![Vec::new(); size.iter().product()] };
        for (t, tet) in choice.mesh.tets.iter().enumerate() {
            let center: DVec3 = tet.iter().map(|&v| choice.mesh.positions[v as usize] * 0.25).sum();
            let [x, y, z] = grid.cell(center);
            grid.tets[(z * size[1] + y) * size[0] + x].push(t as u32);
        }
        grid
    }

    fn cell(&self, p: DVec3) -> [usize; 3] {
        let cell = ((p - self.lowest) / self.side).to_array();
        std::array::from_fn(|c| (cell[c].max(0.0) as usize).min(self.size[c] - 1))
    }

    /// The hold of a joint at a point: in the tet there that is most the joint's, if any is its own.
    fn hold(&self, choice: &Choice, joint: usize, p: DVec3) -> Option<Hold> {
        let [x, y, z] = self.cell(p);
        let around = |c: usize, n: usize| c.saturating_sub(1)..(c + 2).min(n);
        let mut best: Option<(f64, Hold)> = None;
        for z in around(z, self.size[2]) {
            for y in around(y, self.size[1]) {
                for x in around(x, self.size[0]) {
                    for &tet in &self.tets[(z * self.size[1] + y) * self.size[0] + x] {
                        let Some(barycentric) = inside(choice.mesh, tet as usize, p) else { continue };
                        let own = weight(choice, joint, tet as usize, &barycentric);
                        if own >= OWN && best.as_ref().is_none_or(|b| own > b.0) {
                            best = Some((own, Hold { joint: joint as u32, tet, barycentric, point: p }));
                        }
                    }
                }
            }
        }
        best.map(|b| b.1)
    }
}

/// Barycentric coordinates of a point in a tet; none where it is outside.
fn inside(mesh: &TetMesh, tet: usize, p: DVec3) -> Option<[f64; 4]> {
    let [a, b, c, d] = mesh.tets[tet].map(|v| mesh.positions[v as usize]);
    let m = DMat3::from_cols(b - a, c - a, d - a).inverse() * (p - a);
    let barycentric = [1.0 - m.element_sum(), m.x, m.y, m.z];
    (barycentric.iter().all(|&b| b >= -1e-9)).then_some(barycentric)
}

/// Parts of the cage: small hard ones are driven whole by their joint, and any other that nothing holds is held at the tet
/// that is most its joint's.
fn components(choice: &Choice, holds: &mut Vec<Hold>) -> Vec<u32> {
    let mut driver = vec![FREE; choice.mesh.positions.len()];
    let parts = parts(choice.mesh);
    let volume = |tets: &[usize]| -> f64 { tets.iter().map(|&t| volume(choice.mesh, t)).sum() };
    let total: f64 = parts.iter().map(|c| volume(c)).sum();
    for tets in &parts {
        let mut vertices: Vec<usize> = tets.iter().flat_map(|&t| choice.mesh.tets[t].map(|v| v as usize)).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut sums = vec![0.0; choice.weights.joints.len()];
        vertices.iter().for_each(|&v| sums.iter_mut().zip(&choice.weights.rows[v]).for_each(|(s, w)| *s += w));
        let Some(joint) = (0..sums.len()).max_by(|&a, &b| sums[a].total_cmp(&sums[b]).then(b.cmp(&a))) else {
            continue;
        };
        let pure = vertices.iter().all(|&v| choice.weights.rows[v][joint] >= ALL_OF_IT);
        let held = |h: &Hold| tets.binary_search(&(h.tet as usize)).is_ok();
        if pure && volume(tets) < SMALL * total && !choice.loose[joint] {
            vertices.iter().for_each(|&v| driver[v] = joint as u32);
            holds.retain(|h| !held(h));
        } else if !holds.iter().any(held) {
            let weakest = |t: usize| {
                choice.mesh.tets[t].iter().map(|&v| choice.weights.rows[v as usize][joint]).fold(1.0, f64::min)
            };
            let best = tets.iter().copied().max_by(|&a, &b| weakest(a).total_cmp(&weakest(b)).then(b.cmp(&a)));
            let corners = best.into_iter().flat_map(|t| (0..4).map(move |k| (t, k)));
            holds.extend(corners.map(|(t, k)| Hold {
                joint: joint as u32,
                tet: t as u32,
                barycentric: std::array::from_fn(|i| f64::from(u8::from(i == k))),
                point: choice.mesh.positions[choice.mesh.tets[t][k] as usize],
            }));
        }
    }
    driver
}

fn volume(mesh: &TetMesh, tet: usize) -> f64 {
    let [a, b, c, d] = mesh.tets[tet].map(|v| mesh.positions[v as usize]);
    (b - a).cross(c - a).dot(d - a) / 6.0
}

/// Tets that hang together, each list ascending.
fn parts(mesh: &TetMesh) -> Vec<Vec<usize>> {
    let mut of_vertex = vec![usize::MAX; mesh.positions.len()];
    let mut tets_of: Vec<Vec<usize>> = vec![Vec::new(); mesh.positions.len()];
    for (t, tet) in mesh.tets.iter().enumerate() {
        tet.iter().for_each(|&v| tets_of[v as usize].push(t));
    }
    let (mut seen, mut out) = (vec![false; mesh.tets.len()], Vec::new());
    for first in 0..mesh.tets.len() {
        if seen[first] {
            continue;
        }
        let (mut component, mut front) = (Vec::new(), vec![first]);
        seen[first] = true;
        while let Some(t) = front.pop() {
            component.push(t);
            for v in mesh.tets[t].map(|v| v as usize) {
                if std::mem::replace(&mut of_vertex[v], out.len()) != out.len() {
                    front.extend(tets_of[v].iter().copied().filter(|&n| !std::mem::replace(&mut seen[n], true)));
                }
            }
        }
        component.sort_unstable();
        out.push(component);
    }
    out
}

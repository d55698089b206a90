//! Which vertices of a cage are driven by which joint.
//!
//! A cage vertex is driven where it is nearly all one joint's and lies in the core of one of its bones. The core's radius is a
//! share of the flesh's thickness, no less than what a cell can resolve, and shrinks towards joints. No tet has driven
//! vertices of two joints: between two cores there is always a layer that can give.

use super::bones::{Beside, Bone};
use super::weights::CageWeights;
use animimic_scene::TetMesh;

/// Share of the flesh around a bone that goes with it.
const CORE: f64 = 0.5;
/// Least radius of a core [cells]: what a lattice line is sure to meet.
const LEAST_RADIUS: f64 = 0.6;
/// Least weight of the joint in its core.
const PURE: f64 = 0.75;
/// Components with less than this share of the body's volume, all of them one joint's, are hard: eyes, buttons, teeth.
const SMALL: f64 = 0.02;
/// Least weight of the joint everywhere in such a component.
const ALL_OF_IT: f64 = 0.9;

/// No joint drives this vertex.
pub const FREE: u32 = u32::MAX;

/// What drivers are chosen from.
pub struct Choice<'a> {
    /// The cage.
    pub mesh: &'a TetMesh,
    /// Side of its cells [model unit].
    pub spacing: f64,
    /// Weights at its vertices.
    pub weights: &'a CageWeights,
    /// Bones of the joints.
    pub bones: &'a [Bone],
    /// Joints (indices into the weights' joints) that do not drive.
    pub loose: &'a [bool],
}

/// The driving joint of every cage vertex, as an index into the weights' joints, or [`FREE`].
pub fn drivers(choice: &Choice) -> Vec<u32> {
    let vertices = choice.mesh.positions.len();
    let mut driver: Vec<u32> = (0..vertices).map(|v| core_joint(choice, v)).collect();
    at_least_one_each(choice, &mut driver);
    part(choice, &mut driver);
    whole_components(choice, &mut driver);
    driver
}

/// The joint in whose core a vertex lies.
fn core_joint(choice: &Choice, v: usize) -> u32 {
    let (joint, weight) = choice.weights.main(v);
    if weight < PURE || choice.loose[joint] {
        return FREE;
    }
    let x = choice.mesh.positions[v];
    let inside = |b: &Beside| {
        let full = (CORE * b.thickness).max(LEAST_RADIUS * choice.spacing);
        // Within a cell and the flesh's thickness of a joint the core narrows to nothing.
        let reach = b.thickness.min(choice.spacing) + LEAST_RADIUS * choice.spacing;
        b.distance <= full * (b.to_joint / reach).min(1.0)
    };
    let own = choice.bones.iter().filter(|b| b.joint == joint);
    if own.map(|b| b.beside(x)).any(|b| inside(&b)) { joint as u32 } else { FREE }
}

/// A joint without any core, whose bones are shorter than cells, drives the vertex that is most its own.
fn at_least_one_each(choice: &Choice, driver: &mut [u32]) {
    for joint in 0..choice.weights.joints.len() {
        if choice.loose[joint] || driver.contains(&(joint as u32)) {
            continue;
        }
        let score = |v: usize| {
            let near = choice.bones.iter().filter(|b| b.joint == joint).map(|b| b.beside(choice.mesh.positions[v]).distance);
            choice.weights.rows[v][joint] - 0.25 * near.fold(f64::INFINITY, f64::min) / choice.spacing
        };
        let own = (0..driver.len()).filter(|&v| driver[v] == FREE && choice.weights.main(v).0 == joint);
        if let Some(best) = own.max_by(|&a, &b| score(a).total_cmp(&score(b)).then(b.cmp(&a))) {
            driver[best] = joint as u32;
        }
    }
}

/// Frees vertices until no tet has driven ones of two joints, the least pure first.
fn part(choice: &Choice, driver: &mut [u32]) {
    for tet in &choice.mesh.tets {
        loop {
            let driven: Vec<usize> = tet.iter().map(|&v| v as usize).filter(|&v| driver[v] != FREE).collect();
            if driven.iter().all(|&v| driver[v] == driver[driven[0]]) {
                break;
            }
            let weight = |v: usize| choice.weights.rows[v][driver[v] as usize];
            let weakest = driven.iter().copied().min_by(|&a, &b| weight(a).total_cmp(&weight(b)).then(a.cmp(&b)));
            weakest.into_iter().for_each(|v| driver[v] = FREE);
        }
    }
}

/// Parts of the cage that hang on nothing: small hard ones go with their joint whole, others by the tet that is most its own.
fn whole_components(choice: &Choice, driver: &mut [u32]) {
    let components = components(choice.mesh);
    let volume = |tets: &[usize]| -> f64 { tets.iter().map(|&t| volume(choice.mesh, t)).sum() };
    let total: f64 = components.iter().map(|c| volume(c)).sum();
    for tets in &components {
        let mut vertices: Vec<usize> = tets.iter().flat_map(|&t| choice.mesh.tets[t].map(|v| v as usize)).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut sums = vec![0.0; choice.weights.joints.len()];
        vertices.iter().for_each(|&v| sums.iter_mut().zip(&choice.weights.rows[v]).for_each(|(s, w)| *s += w));
        let Some(joint) = (0..sums.len()).max_by(|&a, &b| sums[a].total_cmp(&sums[b]).then(b.cmp(&a))) else { continue };
        let pure = vertices.iter().all(|&v| choice.weights.rows[v][joint] >= ALL_OF_IT);
        if pure && volume(tets) < SMALL * total && !choice.loose[joint] {
            vertices.iter().for_each(|&v| driver[v] = joint as u32);
        } else if vertices.iter().all(|&v| driver[v] == FREE) {
            let weakest = |t: usize| choice.mesh.tets[t].iter().map(|&v| choice.weights.rows[v as usize][joint]).fold(1.0, f64::min);
            let best = tets.iter().copied().max_by(|&a, &b| weakest(a).total_cmp(&weakest(b)).then(b.cmp(&a)));
            best.into_iter().flat_map(|t| choice.mesh.tets[t]).for_each(|v| driver[v as usize] = joint as u32);
        }
    }
}

fn volume(mesh: &TetMesh, tet: usize) -> f64 {
    let [a, b, c, d] = mesh.tets[tet].map(|v| mesh.positions[v as usize]);
    (b - a).cross(c - a).dot(d - a) / 6.0
}

/// Tets that hang together, each list ascending.
fn components(mesh: &TetMesh) -> Vec<Vec<usize>> {
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

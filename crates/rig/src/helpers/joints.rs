//! Found helpers as joints, slots and keys of a rig.
//!
//! A helper hangs under the base joint q that it overlaps most, with the identity as its rest: W_h⁰ = G_q⁰. Its slots have
//! B = (G_q⁰)⁻¹ D_h⁰ A_h, so that it stands at D_h⁰ A_h at rest, and its keys are L_f = G_q,f⁻¹ D_h,f (D_h⁰)⁻¹ G_q⁰.

use super::INFLUENCES;
use super::problem::{Helper, Point, Problem, State};
use super::weights;
use animimic_scene::{Joint, Mesh, Motion, Refined, Rig, Slot, Transform};
use glam::DMat3;
use rayon::prelude::*;

/// Keys are translations, rotations and scales: a parent that would need more, relative to their size, is passed over for its own parent.
const SHEAR: f64 = 1e-6;

/// Rounds of weights and stored position of a vertex, where they depend on each other.
const LAST_ROUNDS: usize = 4;

/// Index of the largest number, the first of equals.
pub fn largest(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, k| if values[k] > values[best] { k } else { best })
}

/// Solves all active vertices, adds the helpers that are used to the rig, and keys to the motions.
pub fn attach(
    problem: &Problem,
    helpers: &[Helper],
    state: &State,
    rig: &Rig,
    mesh: &Mesh,
    clips: &[Refined],
) -> (Rig, Vec<Motion>) {
    let points = points(problem, helpers, state, mesh);
    let overlap = overlaps(problem, &points, helpers.len());
    let used: Vec<usize> = (0..helpers.len()).filter(|&h| overlap[h].iter().any(|x| *x > 0.0)).collect();
    let mut out = Rig { skeleton: rig.skeleton.clone(), skin: rig.skin.clone() };
    let mut motions: Vec<Motion> = clips.iter().map(|c| c.motion.clone()).collect();
    let groups = problem.spaces.shared.len();
    let mut slot_of = vec![vec![0u32; groups]; helpers.len()];
    for (number, &h) in used.iter().enumerate() {
        let helper = &helpers[h];
        let parent = parent(problem, rig, helper, largest(&overlap[h]));
        let joint = out.skeleton.joints.len();
        let name = format!("helper_{}", number + 1);
        out.skeleton.joints.push(Joint { name, parent: Some(parent), rest: Transform::IDENTITY, node: None });
        for (motion, range) in motions.iter_mut().zip(&problem.clips) {
            for (pose, f) in motion.poses.iter_mut().zip(range.clone()) {
                pose.locals.push(key(problem, helper, parent, f).0);
            }
        }
        let inverse_rest = problem.world[0][parent].inverse();
        for g in 0..groups {
            let Some(rest) = helper.rest[g] else { continue };
            slot_of[h][g] = out.skin.slots.len() as u32;
            out.skin.slots.push(Slot { joint, inverse_bind: inverse_rest * helper.moved[0] * rest });
        }
    }
    let base = problem.slots();
    for (v, point) in points.into_iter().enumerate() {
        let Some(mut point) = point else { continue };
        for i in &mut point.influences {
            if let Some(h) = (i.slot as usize).checked_sub(base) {
                i.slot = slot_of[h][point.group];
            }
        }
        out.skin.influences[v] = point.influences;
        out.skin.bind_positions[v] = point.stored;
    }
    (out, motions)
}

/// Vertices with new influences \[vertex\]; `None` where the file's own stay. In parts that a helper moves no vertex has more than four.
fn points(problem: &Problem, helpers: &[Helper], state: &State, mesh: &Mesh) -> Vec<Option<Point>> {
    let solve = |v: usize| {
        let mut point = problem.point(v);
        if let Some(near) = state.nearest(problem, v) {
            point.influences.clone_from(&near.influences);
            point.stored = if near.vertex == v { near.stored } else { problem.rebound(helpers, &point) };
            point.emphasis.clone_from(&near.emphasis);
        }
        for _ in 0..LAST_ROUNDS {
            if !weights::improve(problem, &mut point, helpers) {
                break;
            }
        }
        point
    };
    let solved: Vec<Point> = problem.active.par_iter().map(|&v| solve(v)).collect();
    let mut of_welded: Vec<Option<&Point>> = vec![None; mesh.welded_count];
    solved.iter().for_each(|p| of_welded[mesh.welded[p.vertex] as usize] = Some(p));
    let mut out: Vec<Option<Point>> = mesh.welded.iter().map(|&w| of_welded[w as usize].cloned()).collect();
    let helped = |point: &Option<Point>| {
        point.as_ref().is_some_and(|p| p.influences.iter().any(|i| i.slot as usize >= problem.slots()))
    };
    for part in &mesh.parts {
        let range = part.vertices.clone();
        if !out[range.clone()].iter().any(helped) {
            out[range].fill(None);
            continue;
        }
        out[range.clone()].par_iter_mut().zip(range).for_each(|(point, v)| {
            if point.is_none() && problem.base[v].len() > INFLUENCES {
                *point = Some(solve(v));
            }
        });
    }
    out
}

/// Σ_v w_vh w_v,j over the base weights of joint j, \[helper\]\[joint\].
fn overlaps(problem: &Problem, points: &[Option<Point>], helpers: usize) -> Vec<Vec<f64>> {
    let mut out = vec![vec![0.0; problem.joints]; helpers];
    for (v, point) in points.iter().enumerate() {
        for i in point.iter().flat_map(|p| &p.influences) {
            let Some(h) = (i.slot as usize).checked_sub(problem.slots()) else { continue };
            problem.base[v].iter().for_each(|b| out[h][problem.joint_of(b.slot)] += i.weight * b.weight);
        }
    }
    out
}

/// `joint`, or its nearest ancestor under which all keys are translations, rotations and scales; where there is none, the one that comes nearest.
fn parent(problem: &Problem, rig: &Rig, helper: &Helper, joint: usize) -> usize {
    let up = |j: &usize| rig.skeleton.joints[*j].parent;
    let shear = |j: usize| (1..problem.targets.len()).map(|f| key(problem, helper, j, f).1).fold(0.0, f64::max);
    let mut best = (f64::MAX, joint);
    for j in std::iter::successors(Some(joint), up) {
        let left = shear(j);
        if left <= SHEAR {
            return j;
        }
        if left < best.0 {
            best = (left, j);
        }
    }
    best.1
}

/// The helper's local transform in a frame, and what that leaves out relative to its size.
fn key(problem: &Problem, helper: &Helper, parent: usize, frame: usize) -> (Transform, f64) {
    let world = |f: usize| problem.world[f][parent];
    let local = world(frame).inverse() * helper.moved[frame] * helper.moved[0].inverse() * world(0);
    let size = |m: DMat3| m.to_cols_array().iter().fold(0.0f64, |s, x| s.max(x.abs()));
    let mut trs = Transform::from_affine(local);
    // A scale that is one up to rounding is no key.
    if (trs.scale - 1.0).abs().max_element() < SHEAR {
        trs.scale = glam::DVec3::ONE;
    }
    let shear = size(trs.affine().matrix3 - local.matrix3) / size(local.matrix3);
    (trs, if shear.is_finite() { shear } else { f64::MAX })
}

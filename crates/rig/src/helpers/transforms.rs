//! Rigid displacements of the helpers by weighted Procrustes, one helper after the other, frame by frame.
//!
//! With q_v = y_v − Σ_{k≠h} w_vk p_vk the best D = (R, t) for min Σ_v ‖q_v − w_vh D x_v‖² has R = polar(Σ w_vh q_v (x_v − x̄)ᵀ) and
//! t = q̄ − R x̄, x̄ = Σ w² x / Σ w², q̄ = Σ w q / Σ w² (Le & Deng 2012, eq. 8; Kabsch 1976 with reflections excluded).
//! Six more points around x̄ of small weight go where the helper goes in the neighbouring frames as seen from its joint: what a thin or small
//! set of vertices leaves open stays smooth and proper.

use super::problem::{Helper, Point, Problem, State};
use animimic_math::lanes::Mat3x4;
use animimic_math::polar3::polar3;
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;

/// Weight of the added points, as a share of Σ w: the helper's own have Σ w², so helpers of small weights everywhere, which would have to move
/// far for little, are held harder.
const HELD: f64 = 1e-3;
/// Least spread of a helper's points, as a share of the diagonal: the arm on which the added points hold a rotation.
const LEAST_SPREAD: f64 = 5e-3;

/// Sums of one Procrustes problem.
#[derive(Default)]
struct Sums {
    /// Σ w².
    weight: f64,
    /// Σ w.
    reach: f64,
    x: DVec3,
    q: DVec3,
    outer: DMat3,
}

impl Sums {
    /// A point at x with weight w whose share of the target is q, counted c times: c ‖q − w D x‖².
    fn add(&mut self, c: f64, w: f64, x: DVec3, q: DVec3) {
        self.weight += c * w * w;
        self.reach += c * w;
        self.x += x * (c * w * w);
        self.q += q * (c * w);
        self.outer += outer(q * (c * w), x);
    }

    fn rigid(&self) -> DAffine3 {
        let (x, q) = (self.x / self.weight, self.q / self.weight);
        let r = rotation(&(self.outer - outer(q, x) * self.weight));
        DAffine3::from_mat3_translation(r, q - r * x)
    }
}

/// a bᵀ.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

fn rotation(m: &DMat3) -> DMat3 {
    let size = m.to_cols_array().iter().fold(0.0f64, |s, x| s.max(x.abs()));
    if size <= 0.0 {
        return DMat3::IDENTITY;
    }
    let rows = m.transpose().to_cols_array_2d().map(|row| row.map(|x| x / size));
    let r = polar3(&Mat3x4::from_rows([rows; 4])).r.lane(0);
    DMat3::from_cols_array_2d(&r).transpose()
}

/// A point's share in a helper.
struct Member {
    point: usize,
    weight: f64,
    /// At rest [model unit].
    x: DVec3,
}

/// Finds all displacements anew for the present weights.
pub fn solve(problem: &Problem, state: &State, helpers: &mut [Helper]) {
    let members = members(problem, state, helpers);
    for (helper, list) in helpers.iter_mut().zip(&members) {
        place(problem, helper, list.iter().map(|m| (m.weight, m.x)));
    }
    let frames = problem.targets.len();
    let first = usize::from(problem.spaces.rest_is_bind());
    let found: Vec<Vec<DAffine3>> =
        (first..frames).into_par_iter().map(|f| frame(problem, &state.points, helpers, &members, f)).collect();
    for (f, found) in found.into_iter().enumerate() {
        helpers.iter_mut().zip(found).for_each(|(h, d)| h.moved[f + first] = d);
    }
}

fn members(problem: &Problem, state: &State, helpers: &[Helper]) -> Vec<Vec<Member>> {
    let mut out: Vec<Vec<Member>> = helpers.iter().map(|_| Vec::new()).collect();
    for (at, p) in state.points.iter().enumerate() {
        for i in &p.influences {
            let Some(h) = (i.slot as usize).checked_sub(problem.slots()) else { continue };
            let Some(rest) = helpers[h].rest[p.group] else { continue };
            out[h].push(Member { point: at, weight: i.weight, x: rest.transform_point3(p.stored) });
        }
    }
    out
}

/// Middle and spread of a helper's points (weight, rest); they stay where there are none.
pub fn place(problem: &Problem, helper: &mut Helper, points: impl Iterator<Item = (f64, DVec3)> + Clone) {
    let sum: f64 = points.clone().map(|p| p.0 * p.0).sum();
    if sum <= 0.0 {
        return;
    }
    helper.centre = points.clone().map(|(w, x)| x * (w * w)).sum::<DVec3>() / sum;
    let square: f64 = points.map(|(w, x)| w * w * x.distance_squared(helper.centre)).sum();
    helper.spread = (square / sum).sqrt().max(LEAST_SPREAD * problem.diagonal);
}

/// All helpers' displacements in one frame, each in turn with the others as they are by then.
fn frame(
    problem: &Problem,
    points: &[Point],
    helpers: &[Helper],
    members: &[Vec<Member>],
    frame: usize,
) -> Vec<DAffine3> {
    let mut missing: Vec<DVec3> = points.iter().map(|p| problem.missing(helpers, p, frame)).collect();
    let mut out = Vec::with_capacity(helpers.len());
    for (helper, list) in helpers.iter().zip(members) {
        let before = helper.moved[frame];
        if list.is_empty() {
            out.push(before);
            continue;
        }
        let mut sums = Sums::default();
        for m in list {
            let count = points[m.point].emphasis_in(frame);
            sums.add(count, m.weight, m.x, missing[m.point] + before.transform_point3(m.x) * m.weight);
        }
        hold(helper, &neighbours(problem, helper, frame), &mut sums);
        let after = sums.rigid();
        for m in list {
            let step = after.transform_point3(m.x) - before.transform_point3(m.x);
            missing[m.point] -= step * m.weight;
        }
        out.push(after);
    }
    out
}

/// The added points around the helper's middle; they go where `near` brings them on average.
fn hold(helper: &Helper, near: &[DAffine3], sums: &mut Sums) {
    let w = (HELD * sums.reach / 6.0).sqrt();
    for k in 0..6 {
        let mut z = helper.centre;
        z[k % 3] += if k < 3 { helper.spread } else { -helper.spread };
        let target: DVec3 = near.iter().map(|n| n.transform_point3(z)).sum::<DVec3>() / near.len() as f64;
        sums.add(1.0, w, z, target * w);
    }
}

/// The helper's displacement in the frames before and after, brought to this one by its joint; at a clip's end its own.
fn neighbours(problem: &Problem, helper: &Helper, frame: usize) -> Vec<DAffine3> {
    let joint = |f: usize| problem.world[f][helper.joint];
    let seen = |f: usize| joint(frame) * joint(f).inverse() * helper.moved[f];
    let clip = problem.clips.iter().find(|c| c.contains(&frame));
    match clip {
        Some(c) if c.contains(&(frame - 1)) && c.contains(&(frame + 1)) => vec![seen(frame - 1), seen(frame + 1)],
        _ => vec![helper.moved[frame]],
    }
}

/// The rigid displacements that bring a few (weight, point) from rest to their targets, in every frame; what they leave open follows `helper.joint`.
pub fn of_points(problem: &Problem, points: &[(f64, &Point)], helper: &mut Helper) {
    let rest_at = |p: &Point| helper.rest[p.group].map(|m| m.transform_point3(p.stored));
    let rest: Vec<(f64, usize, DVec3)> = points.iter().filter_map(|(w, p)| Some((*w, p.vertex, rest_at(p)?))).collect();
    place(problem, helper, rest.iter().map(|r| (r.0, r.2)));
    let start = problem.world[0][helper.joint].inverse();
    let helper_now: &Helper = helper;
    let found: Vec<DAffine3> = (0..problem.targets.len())
        .into_par_iter()
        .map(|f| {
            if f == 0 {
                return DAffine3::IDENTITY;
            }
            let follow = problem.world[f][helper_now.joint] * start;
            let mut sums = Sums::default();
            rest.iter().for_each(|(w, v, x)| sums.add(1.0, *w, *x, problem.targets[f][*v] * *w));
            hold(helper_now, &[follow], &mut sums);
            sums.rigid()
        })
        .collect();
    helper.moved = found;
}

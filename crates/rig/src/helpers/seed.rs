//! Where new helpers begin: around the points that are farthest off, moved as their neighbourhood should move.

use super::problem::{Helper, Point, Problem, State};
use super::transforms;
use super::weights::Aims;
use glam::DAffine3;
use rayon::prelude::*;

/// Fewest points of a neighbourhood, so that its rotation is determined.
const LEAST_POINTS: usize = 5;
/// Weight of the farthest of them: the worst point itself is to be served best.
const LEAST_WEIGHT: f64 = 0.05;

/// At most `count` new helpers, none where every point is at its target.
pub fn seeds(problem: &Problem, state: &State, helpers: &[Helper], count: usize) -> Vec<Helper> {
    let mut errors: Vec<f64> =
        state.points.par_iter().map(|p| Aims::new(problem, p).cost(problem, helpers, p)).collect();
    let size = (state.points.len() / (2 * (helpers.len() + count))).max(LEAST_POINTS);
    let mut out = Vec::new();
    for _ in 0..count {
        let worst = (0..errors.len()).max_by(|&a, &b| errors[a].total_cmp(&errors[b]).then(b.cmp(&a)));
        let Some(worst) = worst.filter(|&w| errors[w] > 0.0) else { break };
        let near = nearest(problem, state, worst, size);
        let points: Vec<_> = near.iter().map(|&(w, k)| (w, &state.points[k])).collect();
        let joint = main_joint(problem, &points);
        let mut helper = Helper {
            joint,
            rest: problem.spaces.maps(joint, state.points[worst].group),
            moved: vec![DAffine3::IDENTITY; problem.targets.len()],
            centre: problem.rest[state.points[worst].vertex],
            spread: 0.0,
        };
        transforms::of_points(problem, &points, &mut helper);
        out.push(helper);
        near.iter().for_each(|n| errors[n.1] = 0.0);
    }
    out
}

/// The `size` points nearest to one at rest, itself first, all of its group, with weights that fall from 1 towards the farthest.
fn nearest(problem: &Problem, state: &State, at: usize, size: usize) -> Vec<(f64, usize)> {
    let place = |k: usize| problem.rest[state.points[k].vertex];
    let group = state.points[at].group;
    let mut all: Vec<(f64, usize)> = (0..state.points.len())
        .filter(|&k| state.points[k].group == group)
        .map(|k| (place(k).distance_squared(place(at)), k))
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all.truncate(size);
    let farthest = all.last().map_or(1.0, |p| p.0).max(f64::MIN_POSITIVE);
    all.into_iter().map(|(d, k)| ((1.0 - d / farthest).powi(2).max(LEAST_WEIGHT), k)).collect()
}

/// The joint with the largest base weight over some points.
fn main_joint(problem: &Problem, points: &[(f64, &Point)]) -> usize {
    let mut sums = vec![0.0; problem.joints];
    for i in points.iter().flat_map(|p| &problem.base[p.1.vertex]) {
        sums[problem.joint_of(i.slot)] += i.weight;
    }
    super::joints::largest(&sums)
}

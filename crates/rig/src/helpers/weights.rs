//! Weights of one vertex at a time: min wᵀ G w with w ≥ 0, Σ w = 1 and at most four not 0, G_ij = Σ_f ω_f d_i,f · d_j,f, d = place − target.
//!
//! The constraint Σ w = 1 turns the least squares of the module's header into this form, and its solution on a support is w ∝ G⁻¹ 1. The
//! support is an active set (Lawson & Hanson 1974) that ends at four, after which members are exchanged while that helps.

use super::INFLUENCES;
use super::problem::{Helper, Point, Problem, State, sorted};
use animimic_math::small_spd::solve_spd;
use animimic_scene::Influence;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Base slots and helpers among which a vertex chooses.
const BASE_CANDIDATES: usize = 8;
const HELPER_CANDIDATES: usize = 10;
const CANDIDATES: usize = BASE_CANDIDATES + HELPER_CANDIDATES + INFLUENCES;
/// A helper may move vertices within so many of its spreads, and at least within a share of the diagonal: what is farther only looks alike.
const REACH_SPREADS: f64 = 4.0;
const REACH: f64 = 0.3;
/// Added to the diagonal of G, relative to it: equal candidates share.
const RIDGE: f64 = 1e-9;
/// Exchanges must gain this share.
const GAIN: f64 = 1e-4;
/// Smaller weights are not worth an influence.
const LEAST_WEIGHT: f64 = 1e-3;
const STEPS: usize = 40;

type Gram = [[f64; CANDIDATES]; CANDIDATES];

/// Solves the weights of all points for the present displacements.
pub fn solve(problem: &Problem, state: &mut State, helpers: &[Helper]) {
    state.points.par_iter_mut().for_each(|p| {
        improve(problem, p, helpers);
    });
}

/// Gives a point its best influences, and the stored position that goes with them. Returns whether another round may help: weights and stored
/// position depend on each other where the displayed rest is not the bind pose.
pub fn improve(problem: &Problem, point: &mut Point, helpers: &[Helper]) -> bool {
    let aims = Aims::new(problem, point);
    let mut next = Point { influences: best_influences(problem, point, helpers, &aims), ..point.clone() };
    if problem.spaces.shared[point.group].is_some() {
        *point = next;
        return false;
    }
    next.stored = problem.rebound(helpers, &next);
    point.stored = problem.rebound(helpers, point);
    let better = aims.cost(problem, helpers, &next) < (1.0 - GAIN) * aims.cost(problem, helpers, point);
    if better || point.influences.len() > INFLUENCES {
        *point = next;
    }
    better
}

fn best_influences(problem: &Problem, point: &Point, helpers: &[Helper], aims: &Aims) -> Vec<Influence> {
    let turns = problem.turns(helpers, point);
    let mut candidates = candidates(problem, point, helpers, aims);
    if !turns.is_empty() {
        candidates.iter_mut().for_each(|(slot, d)| *d = aims.offsets(problem, helpers, *slot, point, &turns));
    }
    let mut gram = [[0.0; CANDIDATES]; CANDIDATES];
    for i in 0..candidates.len() {
        for j in 0..=i {
            gram[i][j] = dot(&candidates[i].1, &candidates[j].1);
            gram[j][i] = gram[i][j];
        }
    }
    let start: Vec<(usize, f64)> = candidates
        .iter()
        .enumerate()
        .filter_map(|(k, (slot, _))| point.influences.iter().find(|i| i.slot == *slot).map(|i| (k, i.weight)))
        .collect();
    let found = simplex(&gram, candidates.len(), start);
    sorted(found.into_iter().map(|(k, weight)| Influence { slot: candidates[k].0, weight }).collect())
}

/// Where a point should be in every frame, side by side in memory, and what the frame counts.
pub struct Aims {
    targets: Vec<DVec3>,
    /// √ω.
    roots: Vec<f64>,
}

impl Aims {
    /// Gathers them.
    pub fn new(problem: &Problem, point: &Point) -> Self {
        let frames = 0..problem.targets.len();
        Self {
            targets: frames.clone().map(|f| problem.targets[f][point.vertex]).collect(),
            roots: frames.map(|f| point.count(problem, f).sqrt()).collect(),
        }
    }

    /// Σ_f ω_f ‖place − target‖² of a point with its influences.
    pub fn cost(&self, problem: &Problem, helpers: &[Helper], point: &Point) -> f64 {
        let carriers: Vec<_> =
            point.influences.iter().map(|i| (problem.carrier(helpers, i.slot, point), i.weight)).collect();
        let off = |(f, target): (usize, &DVec3)| {
            let place: DVec3 = carriers.iter().map(|(carried, w)| carried(f) * *w).sum();
            point.count(problem, f) * (*target - place).length_squared()
        };
        self.targets.iter().enumerate().map(off).sum()
    }

    /// √ω (place − target) in every frame. Where the displayed rest is not the bind pose, the stored position moves with the weights so
    /// that the rest stays: y_f(w) = (Σ w M_f)(Σ w M_0)⁻¹ x, whose linearisation is Σ w (M_k,f X − B_f (M_k,0 X − x)),
    /// B_f = (Σ w M_f)(Σ w M_0)⁻¹ (`turns`).
    fn offsets(&self, problem: &Problem, helpers: &[Helper], slot: u32, point: &Point, turns: &[DMat3]) -> Vec<DVec3> {
        let carried = problem.carrier(helpers, slot, point);
        let rest = carried(0) - problem.rest[point.vertex];
        let each = self.targets.iter().zip(&self.roots).enumerate();
        each.map(|(f, (target, root))| {
            let d = carried(f) - *target;
            turns.get(f).map_or(d, |turn| d - *turn * rest) * *root
        })
        .collect()
    }
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

/// The point's present and base slots, and the helpers in reach that come nearest, alone or together with one base slot; each with its
/// offsets without turns.
fn candidates(problem: &Problem, point: &Point, helpers: &[Helper], aims: &Aims) -> Vec<(u32, Vec<DVec3>)> {
    let offsets = |slot: u32| aims.offsets(problem, helpers, slot, point, &[]);
    let base = problem.base[point.vertex].iter().take(BASE_CANDIDATES).map(|i| i.slot);
    let mut out: Vec<(u32, Vec<DVec3>)> = base.map(|slot| (slot, offsets(slot))).collect();
    let squares: Vec<f64> = out.iter().map(|(_, d)| dot(d, d)).collect();
    let mut scored: Vec<(f64, u32, Vec<DVec3>)> = Vec::new();
    for (h, helper) in helpers.iter().enumerate() {
        let reach = (REACH_SPREADS * helper.spread).max(REACH * problem.diagonal);
        if helper.rest[point.group].is_none() || problem.rest[point.vertex].distance(helper.centre) > reach {
            continue;
        }
        let slot = (problem.slots() + h) as u32;
        let own = offsets(slot);
        let alone = dot(&own, &own);
        let together = squares.iter().zip(&out).map(|(c, (_, d))| pair(alone, dot(&own, d), *c).0);
        scored.push((together.fold(alone, f64::min), slot, own));
    }
    scored.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    out.extend(scored.into_iter().take(HELPER_CANDIDATES).map(|(_, slot, own)| (slot, own)));
    for i in point.influences.iter().take(INFLUENCES) {
        if out.iter().all(|c| c.0 != i.slot) {
            out.push((i.slot, offsets(i.slot)));
        }
    }
    out
}

/// The least ‖u a + (1 − u) c‖² for u in [0, 1], from a·a, a·c and c·c; and that u.
fn pair(aa: f64, ac: f64, cc: f64) -> (f64, f64) {
    let curvature = aa - 2.0 * ac + cc;
    let u = if curvature > 0.0 { ((cc - ac) / curvature).clamp(0.0, 1.0) } else { 1.0 };
    (u * u * aa + 2.0 * u * (1.0 - u) * ac + (1.0 - u) * (1.0 - u) * cc, u)
}

fn cost(gram: &Gram, w: &[(usize, f64)]) -> f64 {
    w.iter().map(|&(i, a)| a * w.iter().map(|&(j, b)| gram[i][j] * b).sum::<f64>()).sum()
}

/// min wᵀGw over the first `n` candidates with at most four in the support: the better of the descents from `start` and from the best pair.
fn simplex(gram: &Gram, n: usize, start: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    let sum: f64 = start.iter().map(|s| s.1).sum();
    let given = (sum > 0.0 && start.len() <= INFLUENCES).then(|| settle(gram, rescaled(start)));
    let starts = given.into_iter().chain([best_pair(gram, n)]);
    let ends = starts.map(|w| descend(gram, n, w)).map(|w| (cost(gram, &w), w));
    ends.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(vec![(0, 1.0)], |e| e.1)
}

/// The pair (or one of it) with the smallest cost.
fn best_pair(gram: &Gram, n: usize) -> Vec<(usize, f64)> {
    let mut best = (f64::MAX, (0, 0, 1.0));
    for i in 0..n {
        for j in 0..=i {
            let (cost, u) = pair(gram[i][i], gram[i][j], gram[j][j]);
            if cost < best.0 {
                best = (cost, (i, j, u));
            }
        }
    }
    let (i, j, u) = best.1;
    [(i, u), (j, 1.0 - u)].into_iter().filter(|w| w.1 > 0.0).collect()
}

fn descend(gram: &Gram, n: usize, mut now: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    for _ in 0..STEPS {
        let held = cost(gram, &now);
        let mut slopes: Vec<(f64, usize)> = (0..n)
            .filter(|c| now.iter().all(|w| w.0 != *c))
            .map(|c| (now.iter().map(|&(i, w)| gram[c][i] * w).sum::<f64>() - held, c))
            .filter(|s| s.0 < -GAIN * held)
            .collect();
        slopes.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let next = slopes.iter().map(|s| with(gram, &now, s.1)).find(|w| cost(gram, w) < (1.0 - GAIN) * held);
        let Some(next) = next else { break };
        now = next;
    }
    now.retain(|w| w.1 >= LEAST_WEIGHT);
    settle(gram, rescaled(now))
}

fn rescaled(w: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    let sum: f64 = w.iter().map(|p| p.1).sum();
    w.into_iter().map(|(k, x)| (k, x / sum)).collect()
}

/// The support with one more member; if that makes five, the best four of them.
fn with(gram: &Gram, now: &[(usize, f64)], candidate: usize) -> Vec<(usize, f64)> {
    let mut wider = now.to_vec();
    wider.push((candidate, 0.0));
    let wider = settle(gram, wider);
    if wider.len() <= INFLUENCES {
        return wider;
    }
    let without = |k: usize| {
        let rest: Vec<(usize, f64)> = wider.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, w)| *w).collect();
        settle(gram, rescaled(rest))
    };
    let all = (0..wider.len()).map(without).map(|w| (cost(gram, &w), w));
    all.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(wider.clone(), |b| b.1)
}

/// The best weights on a support, from feasible ones: members that would become negative leave it one by one.
fn settle(gram: &Gram, mut w: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    while w.len() > 1 {
        let Some(best) = on_support(gram, &w) else { break };
        // The longest way towards the best weights on which none is negative.
        let limit = |k: usize| if best[k] < 0.0 { w[k].1 / (w[k].1 - best[k]) } else { 1.0 };
        let (mut step, mut first) = (1.0, None);
        for k in 0..w.len() {
            if best[k] < 0.0 && limit(k) < step {
                (step, first) = (limit(k), Some(k));
            }
        }
        for k in 0..w.len() {
            w[k].1 += step * (best[k] - w[k].1);
        }
        match first {
            Some(k) => {
                w.remove(k);
            }
            None => break,
        }
    }
    rescaled(w)
}

/// G⁻¹ 1 / 1ᵀ G⁻¹ 1 on the support.
fn on_support(gram: &Gram, w: &[(usize, f64)]) -> Option<[f64; INFLUENCES + 1]> {
    const N: usize = INFLUENCES + 1;
    let (mut a, mut one) = ([[0.0; N]; N], [0.0; N]);
    let largest = w.iter().map(|&(i, _)| gram[i][i]).fold(f64::MIN_POSITIVE, f64::max);
    for i in 0..N {
        for j in 0..=i {
            if i < w.len() {
                a[i][j] = gram[w[i].0][w[j].0] + if i == j { RIDGE * largest } else { 0.0 };
                one[i] = 1.0;
            } else if i == j {
                a[i][j] = 1.0;
            }
        }
    }
    let z = solve_spd(a, one)?;
    let sum: f64 = z[..w.len()].iter().sum();
    (sum.is_finite() && sum > 0.0).then(|| z.map(|x| x / sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::SplitMix64;

    fn random_gram(rng: &mut SplitMix64, n: usize) -> Gram {
        let rows: Vec<Vec<f64>> = (0..n).map(|_| (0..9).map(|_| rng.normal() + 0.7).collect()).collect();
        let mut gram = [[0.0; CANDIDATES]; CANDIDATES];
        for i in 0..n {
            for j in 0..n {
                gram[i][j] = rows[i].iter().zip(&rows[j]).map(|(a, b)| a * b).sum();
            }
        }
        gram
    }

    /// Best cost over all supports of at most four, each by exhaustive descent on a fine grid of the simplex's faces.
    fn brute_force(gram: &Gram, n: usize) -> f64 {
        let mut best = f64::MAX;
        for mask in 1u32..(1 << n) {
            if mask.count_ones() as usize <= INFLUENCES {
                let support: Vec<(usize, f64)> = (0..n).filter(|i| mask & (1 << i) != 0).map(|i| (i, 0.0)).collect();
                let solved = on_support(gram, &support).filter(|w| w[..support.len()].iter().all(|x| *x >= 0.0));
                let weights = solved.map(|w| support.iter().zip(w).map(|(s, x)| (s.0, x)).collect::<Vec<_>>());
                best = weights.map_or(best, |w| best.min(cost(gram, &w)));
            }
        }
        best
    }

    #[test]
    fn weights_are_those_of_the_best_four_or_within_a_percent() {
        let mut rng = SplitMix64(5);
        let (mut exact, mut worst) = (0, 1.0f64);
        for _ in 0..300 {
            let n = 8;
            let gram = random_gram(&mut rng, n);
            let found = simplex(&gram, n, Vec::new());
            assert!(found.len() <= INFLUENCES && found.iter().all(|w| w.1 >= 0.0));
            assert!((found.iter().map(|w| w.1).sum::<f64>() - 1.0).abs() < 1e-12);
            let ratio = cost(&gram, &found) / brute_force(&gram, n);
            exact += usize::from(ratio < 1.0 + 1e-3);
            worst = worst.max(ratio);
        }
        println!("{exact} of 300 exact, worst {worst:.3} of the best cost");
        assert!(exact >= 270 && worst < 1.5);
    }

    #[test]
    fn a_point_between_two_candidates_is_halved_between_them() {
        let mut gram = [[0.0; CANDIDATES]; CANDIDATES];
        (gram[0][0], gram[0][1], gram[1][0], gram[1][1], gram[2][2]) = (1.0, -1.0, -1.0, 1.0, 4.0);
        let found = simplex(&gram, 3, vec![(2, 1.0)]);
        println!("{found:?}");
        assert_eq!(found.len(), 2);
        assert!(found.iter().all(|w| (w.1 - 0.5).abs() < 1e-6 && w.0 < 2));
    }
}

//! Where curves bend: joints of limbs along their middle lines.

use super::anatomy::Role;
use glam::DVec3;

/// Where limbs of 1, 2, 3, 4 bones bend if nothing shows it: shares of their length. Hind legs on four bones have knee, hock and toes.
const PROPORTIONS: [&[f64]; 4] = [&[], &[0.48], &[0.43, 0.8], &[0.43, 0.76, 0.9]];
const HIND: &[f64] = &[0.3, 0.62, 0.88];

/// Curves are cut into so many pieces when bends are looked for.
const STEPS: usize = 64;

/// A joint off its usual place by this share of the limb costs as much as a bone that leaves the middle by `STRAY`.
const USUAL: f64 = 0.16;
const STRAY: f64 = 0.012;

/// Usual places of a limb's bends, if its number of bones has any.
pub(super) fn proportions(role: Role, count: usize) -> Option<&'static [f64]> {
    match role {
        Role::Leg(0, rows) if rows > 1 && count == HIND.len() + 1 => Some(HIND),
        _ => PROPORTIONS.get(count - 1).copied(),
    }
}

/// Way along a polyline \[point\].
pub(super) fn ways(points: &[DVec3]) -> Vec<f64> {
    let mut along = vec![0.0];
    points.windows(2).for_each(|w| along.push(along[along.len() - 1] + w[0].distance(w[1])));
    along
}

/// A polyline's points at equal shares of its length.
fn resampled(points: &[DVec3]) -> Vec<DVec3> {
    let along = ways(points);
    let whole = along[along.len() - 1];
    (0..=STEPS)
        .map(|k| {
            let s = whole * k as f64 / STEPS as f64;
            let b = along.partition_point(|&a| a < s).clamp(1, points.len().max(2) - 1).min(points.len() - 1);
            let a = b.saturating_sub(1);
            let u = (s - along[a]) / (along[b] - along[a]).max(1e-300);
            points[a].lerp(points[b], u.clamp(0.0, 1.0))
        })
        .collect()
}

/// Shares of their length at which the bones of curves begin: the polylines that stay nearest to the curves and to usual proportions
/// (dynamic programming over all places). Partners bend at the same shares: one shows where the other, straight one has its knee.
pub(super) fn bends(curves: &[Vec<DVec3>], count: usize, usual: Option<&[f64]>) -> Vec<f64> {
    let curves: Vec<(f64, Vec<DVec3>)> =
        curves.iter().map(|c| (ways(c)[c.len() - 1].max(1e-300), resampled(c))).collect();
    let share = |i: usize| i as f64 / STEPS as f64;
    let usual = |k: usize| usual.map_or(k as f64 / count as f64, |shares| shares[k - 1]);
    let stray = |a: usize, b: usize| {
        let of = |(whole, points): &(f64, Vec<DVec3>)| {
            let d = (points[b] - points[a]).normalize_or_zero();
            let off = |p: &DVec3| (*p - points[a]).reject_from_normalized(d).length_squared();
            let between = &points[a + 1..b.max(a + 1)];
            let mean = between.iter().map(off).sum::<f64>() / between.len().max(1) as f64;
            (share(b) - share(a)) * mean / (STRAY * whole * 3.0).powi(2)
        };
        curves.iter().map(of).sum::<f64>() / curves.len() as f64
    };
    // best[k][i]: cheapest way to end bone k at place i.
    let mut best = vec![vec![f64::INFINITY; STEPS + 1]; count + 1];
    let mut from = vec![vec![0usize; STEPS + 1]; count + 1];
    best[0][0] = 0.0;
    for k in 1..=count {
        for i in if k == count { STEPS..STEPS + 1 } else { 1..STEPS } {
            let place = if k == count { 0.0 } else { ((share(i) - usual(k)) / USUAL).powi(2) };
            for a in 0..i {
                if best[k - 1][a] < f64::INFINITY {
                    let cost = best[k - 1][a] + stray(a, i) + place;
                    if cost < best[k][i] {
                        best[k][i] = cost;
                        from[k][i] = a;
                    }
                }
            }
        }
    }
    let mut places = Vec::new();
    let mut at = STEPS;
    for k in (1..=count).rev() {
        at = from[k][at];
        places.push(share(at));
    }
    places.reverse();
    places
}

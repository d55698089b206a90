//! Soft tissue gives way to skinning where it would cut itself more than skinning does.
//!
//! The simulation knows no contacts. After it, crossings of the soft surface are compared with those of the skinned one over
//! the whole clip; where there are more, the surface around them goes back towards skinning, the same in every frame so
//! that nothing pops, and over a distance so that nothing tears. Crossings are counted by pairs of regions of the rest shape: where two
//! regions cross each other no more than when skinned, their crossings only lie elsewhere, and they stay soft. Every place has a
//! circle of its own, which begins small and grows only while that place is still crossed, until no more is crossed than by skinning.

use super::circles::Circles;
use crate::crossings::Crossings;
use animimic_scene::Mesh;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Rounds in which circles appear and grow; then all of the surface is skinned.
const ROUNDS: usize = 24;
/// Radius of full yielding of a new circle, and how much it grows with every round in which its place is still crossed [rest diagonal].
const RADIUS: f64 = 0.002;
const GROWTH: f64 = 1.25;
/// Shares of their radii that are tried for all circles in the end.
const SHRINK: [f64; 3] = [0.5, 0.7, 0.85];
/// Side of a region [rest diagonal].
const REGION: f64 = 0.05;
/// Vertices this many radii from a crossing yield nothing.
const REACH: f64 = 3.0;

/// What was given up.
#[derive(Clone, Debug, PartialEq)]
pub struct Yielded {
    /// Crossing pairs of triangles of plain skinning, summed over frames.
    pub skinned_pairs: usize,
    /// Of the soft surface before.
    pub soft_pairs: usize,
    /// And after.
    pub pairs: usize,
    /// Mean share of the surface that went back to skinning, by vertices.
    pub share: f64,
}

/// Blends `soft` towards `skinned` (\[frame\]\[vertex\]) where that lessens crossings, until neither their sum over frames nor
/// their largest number in a frame exceeds that of skinning.
pub fn give_way(mesh: &Mesh, skinned: &[Vec<DVec3>], soft: &mut [Vec<DVec3>]) -> Yielded {
    let crossings = Crossings::new(mesh);
    let all = |frames: &[Vec<DVec3>]| frames.par_iter().map(|x| crossings.pairs(x)).collect::<Vec<_>>();
    let sum = |pairs: &[Vec<[u32; 2]>]| pairs.iter().map(Vec::len).sum::<usize>();
    let most = |pairs: &[Vec<[u32; 2]>]| pairs.iter().map(Vec::len).max().unwrap_or(0);
    let allowed = all(skinned);
    let mut now = all(soft);
    let (skinned_pairs, soft_pairs) = (sum(&allowed), sum(&now));
    let fine = |now: &[Vec<[u32; 2]>]| sum(now) <= skinned_pairs && most(now) <= most(&allowed);
    let mut share = vec![0.0f64; mesh.positions.len()];
    if fine(&now) {
        return Yielded { skinned_pairs, soft_pairs, pairs: soft_pairs, share: 0.0 };
    }
    let full: Vec<Vec<DVec3>> = soft.to_vec();
    let mut circles = vec![0.0f64; mesh.positions.len()];
    let region = regions(mesh);
    // Between two blends only some vertices move, and only their triangles are asked about anew.
    let blend = |from: &[f64], to: &[f64], before: &[Vec<[u32; 2]>], soft: &mut [Vec<DVec3>]| {
        let moved: Vec<bool> = from.iter().zip(to).map(|(a, b)| a != b).collect();
        let one = |(t, x): (usize, &mut Vec<DVec3>)| {
            for v in (0..x.len()).filter(|&v| moved[v]) {
                x[v] = if to[v] == 1.0 { skinned[t][v] } else { full[t][v].lerp(skinned[t][v], to[v]) };
            }
            crossings.pairs_after(x, &moved, &before[t])
        };
        soft.par_iter_mut().enumerate().map(one).collect::<Vec<_>>()
    };
    for round in 0..=ROUNDS {
        if fine(&now) {
            break;
        }
        let wider = if round == ROUNDS {
            vec![1.0; share.len()]
        } else {
            for v in newly_crossed(mesh, &region, &allowed, &now) {
                circles[v] = (GROWTH * circles[v]).max(RADIUS * mesh.diagonal());
            }
            shares(mesh, &circles, 1.0)
        };
        now = blend(&share, &wider, &now, soft);
        share = wider;
    }
    // The last circles came late: smaller ones may do.
    let (mut tried, mut at) = (share.clone(), now.clone());
    for factor in SHRINK {
        let less = shares(mesh, &circles, factor);
        at = blend(&tried, &less, &at, soft);
        tried = less;
        if fine(&at) {
            (share, now) = (tried.clone(), at.clone());
            break;
        }
    }
    blend(&tried, &share, &at, soft);
    let share = share.iter().sum::<f64>() / share.len().max(1) as f64;
    Yielded { skinned_pairs, soft_pairs, pairs: sum(&now), share }
}

/// The region of each triangle at rest.
fn regions(mesh: &Mesh) -> Vec<[i32; 3]> {
    let side = REGION * mesh.diagonal().max(f64::MIN_POSITIVE);
    let center = |t: &[u32; 3]| t.iter().map(|&v| mesh.positions[v as usize]).sum::<DVec3>() / 3.0;
    mesh.triangles.iter().map(|t| (center(t) / side).to_array().map(|c| c.floor() as i32)).collect()
}

/// Corners, ascending, of triangles that cross and do not when skinned, in those pairs of regions that cross each other more than when
/// skinned: the worst of these, as many as the surplus comes from.
fn newly_crossed(mesh: &Mesh, region: &[[i32; 3]], allowed: &[Vec<[u32; 2]>], now: &[Vec<[u32; 2]>]) -> Vec<usize> {
    let most = allowed.iter().map(Vec::len).max().unwrap_or(0);
    let surplus = |frames: &[usize]| frames.iter().map(|&f| now[f].len() as i64 - allowed[f].len() as i64).sum::<i64>();
    let mut frames: Vec<usize> = (0..now.len()).collect();
    if surplus(&frames) <= 0 {
        frames.retain(|&f| now[f].len() > most);
    }
    let key = |p: &[u32; 2]| {
        let (a, b) = (region[p[0] as usize], region[p[1] as usize]);
        (a.min(b), a.max(b))
    };
    let mut net: BTreeMap<([i32; 3], [i32; 3]), i64> = BTreeMap::new();
    for &f in &frames {
        now[f].iter().for_each(|p| *net.entry(key(p)).or_default() += 1);
        allowed[f].iter().for_each(|p| *net.entry(key(p)).or_default() -= 1);
    }
    let mut worst: Vec<_> = net.into_iter().filter(|n| n.1 > 0).collect();
    worst.sort_by_key(|n| (-n.1, n.0));
    let mut left = surplus(&frames).max(1);
    let mut chosen = BTreeSet::new();
    for (pair, more) in worst {
        if left > 0 {
            chosen.insert(pair);
        }
        left -= more;
    }
    let mut corners: Vec<usize> = Vec::new();
    for &f in &frames {
        let new = now[f].iter().filter(|p| allowed[f].binary_search(p).is_err() && chosen.contains(&key(p)));
        corners.extend(new.flatten().flat_map(|&t| mesh.triangles[t as usize].map(|v| v as usize)));
    }
    corners.sort_unstable();
    corners.dedup();
    corners
}

/// 1 within the circle (`factor` times its radius \[vertex\], 0 for none) of any vertex, falling off smoothly to 0 at [`REACH`] radii.
fn shares(mesh: &Mesh, radii: &[f64], factor: f64) -> Vec<f64> {
    let drawn = mesh.positions.iter().zip(radii).filter(|(_, r)| **r > 0.0);
    let circles = Circles::new(drawn.map(|(x, r)| (*x, factor * r)).collect());
    let one = |x: &DVec3| {
        let u = ((REACH - circles.nearest(*x, REACH)) / (REACH - 1.0)).clamp(0.0, 1.0);
        u * u * (3.0 - 2.0 * u)
    };
    mesh.positions.par_iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::fixtures;

    /// Three octahedra in a row, the third far off; in the soft clip the second has drifted into the first, and the third just drifts.
    #[test]
    fn where_the_soft_surface_cuts_itself_it_goes_back_to_skinning_and_stays_soft_elsewhere() {
        let one = fixtures::octahedron();
        let mut mesh = one.clone();
        for (k, x) in [(1, 2.5), (2, 12.0)] {
            mesh.positions.extend(one.positions.iter().map(|p| *p + DVec3::X * x));
            mesh.triangles.extend(one.triangles.iter().map(|t| t.map(|i| i + 6 * k)));
        }
        mesh.welded = (0..18).collect();
        mesh.welded_count = 18;
        let skinned = vec![mesh.positions.clone(); 3];
        let drift = |t: usize| {
            let offset = DVec3::new(-0.5 * t as f64, 0.1, 0.05);
            let moved = mesh.positions.iter().enumerate();
            moved.map(|(i, p)| if i < 6 { *p } else { *p + offset }).collect::<Vec<_>>()
        };
        let mut soft: Vec<_> = (0..3).map(drift).collect();
        let untouched = soft[0].clone();
        let mut apart = vec![untouched.clone(); 3];
        assert_eq!(give_way(&mesh, &skinned, &mut apart).share, 0.0);
        assert_eq!(apart[2], untouched, "what crosses nothing stays soft");
        let yielded = give_way(&mesh, &skinned, &mut soft);
        println!("{yielded:?}");
        assert!(yielded.soft_pairs > 0 && yielded.pairs == 0 && yielded.share > 0.0);
        assert_eq!(soft[2][12..], drift(2)[12..], "what crosses nothing stays soft beside what crosses");
        let crossings = Crossings::new(&mesh);
        assert!(soft.iter().all(|x| crossings.count(x) == 0));
    }
}

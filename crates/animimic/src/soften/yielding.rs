//! Soft tissue gives way to skinning where it would cut itself more than skinning does.
//!
//! The simulation knows no contacts. After it, crossings of the soft surface are compared with those of the skinned one over
//! the whole clip; where there are new ones, the surface around them goes back towards skinning, the same in every frame so
//! that nothing pops, and over a distance so that nothing tears. The circle grows until no more is crossed than by skinning.

use crate::metrics::crossing_triangles;
use animimic_scene::Mesh;
use glam::DVec3;
use rayon::prelude::*;

/// Rounds in which the circles grow; then all of the surface is skinned.
const ROUNDS: usize = 8;
/// Radius of full yielding in the first round, and how much it grows from round to round [rest diagonal].
const RADIUS: f64 = 0.01;
const GROWTH: f64 = 1.6;
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
    let crossings = |frames: &[Vec<DVec3>]| -> Vec<Vec<[u32; 2]>> {
        frames.par_iter().map(|x| crossing_triangles(mesh, x)).collect()
    };
    let sum = |pairs: &[Vec<[u32; 2]>]| pairs.iter().map(Vec::len).sum::<usize>();
    let most = |pairs: &[Vec<[u32; 2]>]| pairs.iter().map(Vec::len).max().unwrap_or(0);
    let allowed = crossings(skinned);
    let mut now = crossings(soft);
    let (skinned_pairs, soft_pairs) = (sum(&allowed), sum(&now));
    let full: Vec<Vec<DVec3>> = soft.to_vec();
    let mut share = vec![0.0f64; mesh.positions.len()];
    let mut radius = RADIUS * mesh.diagonal();
    for round in 0..=ROUNDS {
        if sum(&now) <= skinned_pairs && most(&now) <= most(&allowed) {
            break;
        }
        if round == ROUNDS {
            share.fill(1.0);
        } else {
            widen(mesh, &new_crossings(mesh, &allowed, &now), radius, &mut share);
            radius *= GROWTH;
        }
        soft.par_iter_mut().zip(&full).zip(skinned).for_each(|((x, full), skin)| {
            for ((x, full), (skin, s)) in x.iter_mut().zip(full).zip(skin.iter().zip(&share)) {
                *x = if *s == 1.0 { *skin } else { full.lerp(*skin, *s) };
            }
        });
        now = crossings(soft);
    }
    let share = share.iter().sum::<f64>() / share.len().max(1) as f64;
    Yielded { skinned_pairs, soft_pairs, pairs: sum(&now), share }
}

/// Rest places of triangles that cross in frames with more crossings than skinning has, and do not cross when skinned.
fn new_crossings(mesh: &Mesh, allowed: &[Vec<[u32; 2]>], now: &[Vec<[u32; 2]>]) -> Vec<DVec3> {
    let mut triangles: Vec<u32> = Vec::new();
    for (allowed, now) in allowed.iter().zip(now).filter(|(a, n)| n.len() > a.len()) {
        triangles.extend(now.iter().filter(|p| allowed.binary_search(p).is_err()).flatten());
    }
    triangles.sort_unstable();
    triangles.dedup();
    let center = |t: u32| mesh.triangles[t as usize].iter().map(|&v| mesh.positions[v as usize]).sum::<DVec3>() / 3.0;
    triangles.into_iter().map(center).collect()
}

/// Raises the share to 1 within a radius of any place, falling off smoothly beyond.
fn widen(mesh: &Mesh, places: &[DVec3], radius: f64, share: &mut [f64]) {
    // The corners of a triangle larger than the radius go with it.
    share.par_iter_mut().zip(&mesh.positions).for_each(|(s, x)| {
        let nearest = places.iter().map(|p| p.distance_squared(*x)).fold(f64::INFINITY, f64::min).sqrt();
        let u = ((REACH * radius - nearest) / ((REACH - 1.0) * radius)).clamp(0.0, 1.0);
        *s = s.max(u * u * (3.0 - 2.0 * u));
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::{fixtures, intersecting_pairs};

    /// Two octahedra side by side; in the soft clip the second has drifted into the first.
    #[test]
    fn where_the_soft_surface_cuts_itself_it_goes_back_to_skinning() {
        let one = fixtures::octahedron();
        let mut mesh = one.clone();
        mesh.positions.extend(one.positions.iter().map(|p| *p + DVec3::X * 2.5));
        mesh.triangles.extend(one.triangles.iter().map(|t| t.map(|i| i + 6)));
        mesh.welded = (0..12).collect();
        mesh.welded_count = 12;
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
        assert!(soft.iter().all(|x| intersecting_pairs(&mesh, x) == 0));
    }
}

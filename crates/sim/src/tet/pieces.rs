//! What each lattice tet holds of the surface.
//!
//! In barycentric coordinates of a tet a triangle stays a triangle and the tet is bᵢ ≥ 0: clipping is four comparisons.

use super::lattice::{Barycentric, Cell, Lattice};
use animimic_scene::solid::Soup;
use glam::DVec3;
use rayon::prelude::*;

/// Coordinates above −SLACK count as inside, so that what lies in a face lies in both tets at it.
const SLACK: f64 = 1e-9;

/// A triangle reaches a face where a corner of the clipped polygon is nearer than this to it.
const AT_FACE: f64 = 1e-7;

/// The part of a triangle in a tet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece {
    pub cell: Cell,
    pub triangle: u32,
    /// Centre of the clipped polygon.
    pub center: DVec3,
    /// Faces (opposite vertex k) that it reaches.
    pub reaches: [bool; 4],
}

/// All pieces, sorted by tet, then triangle.
pub(crate) fn pieces(soup: &Soup, lattice: &Lattice) -> Vec<Piece> {
    let each = |t: usize| {
        let corners = soup.corners(t);
        let lo = corners[0].min(corners[1]).min(corners[2]);
        let hi = corners[0].max(corners[1]).max(corners[2]);
        let mut found = Vec::new();
        lattice.each_cell(lo, hi, |cell| {
            let x = lattice.corners(&cell);
            let b = Barycentric::new(x);
            if let Some((center, reaches)) = clip(corners.map(|p| b.at(p))) {
                let center = (0..4).map(|k| x[k] * center[k]).sum();
                found.push(Piece { cell, triangle: t as u32, center, reaches });
            }
        });
        found
    };
    let mut all: Vec<Piece> = (0..soup.triangles.len()).into_par_iter().flat_map_iter(each).collect();
    all.par_sort_unstable_by_key(|p| (p.cell, p.triangle));
    all
}

/// The polygon in which a triangle meets the tet: its centre, and the faces it reaches.
fn clip(triangle: [[f64; 4]; 3]) -> Option<([f64; 4], [bool; 4])> {
    if (0..4).any(|k| triangle.iter().all(|b| b[k] < -SLACK)) {
        return None;
    }
    let mut polygon = triangle.to_vec();
    let mut next: Vec<[f64; 4]> = Vec::with_capacity(8);
    for k in 0..4 {
        next.clear();
        for i in 0..polygon.len() {
            let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
            let (da, db) = (a[k] + SLACK, b[k] + SLACK);
            if da >= 0.0 {
                next.push(a);
            }
            if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
                let s = da / (da - db);
                next.push(std::array::from_fn(|m| a[m] + s * (b[m] - a[m])));
            }
        }
        std::mem::swap(&mut polygon, &mut next);
        if polygon.is_empty() {
            return None;
        }
    }
    let share = 1.0 / polygon.len() as f64;
    let center = std::array::from_fn(|m| polygon.iter().map(|p| p[m]).sum::<f64>() * share);
    let reaches = std::array::from_fn(|k| polygon.iter().any(|p| p[k].abs() < AT_FACE));
    Some((center, reaches))
}

/// Whether a segment, in barycentric coordinates of its ends, meets the tet.
pub(crate) fn segment_meets(a: [f64; 4], b: [f64; 4]) -> bool {
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for k in 0..4 {
        let (da, db) = (a[k] + SLACK, b[k] + SLACK);
        if da < 0.0 && db < 0.0 {
            return false;
        }
        if da < 0.0 {
            from = from.max(da / (da - db));
        } else if db < 0.0 {
            to = to.min(da / (da - db));
        }
    }
    from <= to
}

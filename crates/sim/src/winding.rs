//! Edges around which the tets wind more than once.
//!
//! A body out of a collapsed start can settle with every tet upright and yet not be its rest shape: the tets around an
//! inner edge then cover it twice. No motion with upright tets undoes that (the number of turns is an integer), so such a
//! state is a true equilibrium; what can be done is to name it.

use crate::body::Body;
use glam::DVec3;
use std::f64::consts::PI;

/// Dihedral angles that add up to more than one and a half turns wind twice: around inner edges of upright tets the sum is
/// a multiple of 2π, around outer edges a body that does not overlap itself has less than 2π.
const WOUND: f64 = 3.0 * PI;

/// Corner pairs of a tet's edges; the faces opposite to the other two corners meet there.
const EDGES: [[usize; 4]; 6] = [[0, 1, 2, 3], [0, 2, 1, 3], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 0, 2], [2, 3, 0, 1]];

/// The edges of a mesh.
#[derive(Clone, Debug, Default)]
pub(crate) struct Edges {
    /// Vertices, lower first, ascending.
    ends: Vec<[u32; 2]>,
    /// Per tet, in the order of [`EDGES`].
    of_tet: Vec<[u32; 6]>,
}

impl Edges {
    pub fn new(tets: &[[u32; 4]]) -> Self {
        let pair = |tet: &[u32; 4], e: &[usize; 4]| [tet[e[0]].min(tet[e[1]]), tet[e[0]].max(tet[e[1]])];
        let mut ends: Vec<[u32; 2]> = tets.iter().flat_map(|t| EDGES.iter().map(move |e| pair(t, e))).collect();
        ends.sort_unstable();
        ends.dedup();
        let index = |p: [u32; 2]| ends.binary_search(&p).expect("listed above") as u32;
        let of_tet = tets.iter().map(|t| EDGES.map(|e| index(pair(t, &e)))).collect();
        Self { ends, of_tet }
    }
}

impl Body {
    /// Edges (lower vertex first) around which the tets wind more than once at `positions`. Where tets are flat or inverted
    /// the sum of their dihedral angles is not a number of turns; count those first.
    pub fn wound_edges(&self, positions: &[DVec3]) -> Vec<[u32; 2]> {
        let mut angle = vec![0.0; self.edges.ends.len()];
        for (tet, edges) in self.tets.iter().zip(&self.edges.of_tet) {
            let [a, b, c, d] = tet.map(|v| positions[v as usize]);
            // Outward unit normals of the faces opposite to each corner.
            let faces = [(b, d, c), (a, c, d), (a, d, b), (a, b, c)];
            let normal = faces.map(|(p, q, r)| (q - p).cross(r - p).normalize_or_zero());
            for (e, edge) in EDGES.iter().zip(edges) {
                angle[*edge as usize] += PI - normal[e[2]].dot(normal[e[3]]).clamp(-1.0, 1.0).acos();
            }
        }
        let wound = |(ends, angle): (&[u32; 2], &f64)| (*angle > WOUND).then_some(*ends);
        self.edges.ends.iter().zip(&angle).filter_map(wound).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_scene::TetMesh;

    #[test]
    fn a_ring_of_tets_is_wound_where_it_goes_around_twice() {
        // Six tets around the edge 0–1, their outer vertices on a circle once, then twice as fast around the same circle.
        let ring = |turns: f64| -> Vec<DVec3> {
            let outer = (0..6).map(|n| f64::from(n) * turns * PI / 3.0).map(|t| DVec3::new(t.cos(), t.sin(), 0.0));
            [DVec3::new(0.0, 0.0, -1.0), DVec3::new(0.0, 0.0, 1.0)].into_iter().chain(outer).collect()
        };
        let tets = (0..6).map(|n| [0, 1, 2 + n, 2 + (n + 1) % 6]).collect();
        let body = Body::new(&TetMesh { positions: ring(1.0), tets }, &[]).expect("a good mesh");
        let (once, twice) = (body.wound_edges(&ring(1.0)), body.wound_edges(&ring(2.0)));
        println!("once around: {once:?}, twice: {twice:?}");
        assert!(once.is_empty());
        assert_eq!(twice, [[0, 1]]);
    }
}

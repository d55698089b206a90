//! Any triangle mesh made ready for a cage: welded, without degenerate and doubled triangles, consistently wound where that is possible.

use super::SurfaceError;
use crate::Mesh;
use glam::DVec3;

/// Twice a triangle's area below this share of the squared diagonal is none.
const NO_AREA: f64 = 1e-14;

/// Triangles that count, with what holds them together.
#[derive(Clone, Debug, Default)]
pub struct Soup {
    /// Welded positions.
    pub positions: Vec<DVec3>,
    /// Triangles over welded vertices.
    pub triangles: Vec<[u32; 3]>,
    /// Vertex of the mesh → welded vertex.
    pub welded: Vec<u32>,
    /// Pairs of triangles that continue each other, with their common edge's vertices.
    pub joints: Vec<([u32; 2], [u32; 2])>,
    /// Surface component \[triangle\].
    pub component: Vec<u32>,
    /// Number of components.
    pub component_count: usize,
    /// Corners of the bounding box.
    pub bounds: [DVec3; 2],
}

impl Soup {
    /// Prepares a mesh.
    ///
    /// # Errors
    /// A coordinate that is not finite, an index out of range, or no triangle with an area.
    pub fn new(mesh: &Mesh) -> Result<Self, SurfaceError> {
        if let Some(index) = mesh.positions.iter().position(|p| !p.is_finite()) {
            return Err(SurfaceError::NotFinite { index });
        }
        let n = mesh.positions.len();
        if let Some(t) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= n)) {
            let vertex = mesh.triangles[t].iter().copied().max().unwrap_or(0);
            return Err(SurfaceError::Index { triangle: t, vertex, vertices: n });
        }
        let welded =
            if mesh.welded.len() == n { mesh.welded.clone() } else { crate::io::weld::by_position(&mesh.positions).0 };
        let count = welded.iter().max().map_or(0, |&m| m as usize + 1);
        let mut positions = vec![DVec3::ZERO; count];
        welded.iter().zip(&mesh.positions).for_each(|(&w, &p)| positions[w as usize] = p);
        let corners = mesh.triangles.iter().flatten().map(|&v| mesh.positions[v as usize]);
        let lo = corners.clone().fold(DVec3::INFINITY, DVec3::min);
        let hi = corners.fold(DVec3::NEG_INFINITY, DVec3::max);
        let least = NO_AREA * (hi - lo).length_squared();
        let mut seen: Vec<([u32; 3], usize)> = Vec::new();
        for (k, t) in mesh.triangles.iter().enumerate() {
            let t = t.map(|v| welded[v as usize]);
            let [a, b, c] = t.map(|v| positions[v as usize]);
            if (b - a).cross(c - a).length() > least {
                let mut key = t;
                key.sort_unstable();
                seen.push((key, k));
            }
        }
        seen.sort_unstable();
        seen.dedup_by_key(|s| s.0);
        seen.sort_unstable_by_key(|s| s.1);
        if seen.is_empty() {
            return Err(SurfaceError::Empty);
        }
        let triangles = seen.iter().map(|&(_, k)| mesh.triangles[k].map(|v| welded[v as usize])).collect();
        let mut soup = Self { positions, triangles, welded, bounds: [lo, hi], ..Self::default() };
        let sides = soup.sides();
        soup.find_components(&sides);
        soup.turn_outwards(&sides);
        soup.joints = soup.joined(&sides);
        Ok(soup)
    }

    /// Corners of a triangle.
    pub fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|v| self.positions[v as usize])
    }

    /// Length of the bounding box's diagonal.
    pub fn diagonal(&self) -> f64 {
        self.bounds[0].distance(self.bounds[1])
    }

    /// (edge, triangle), sorted by edge.
    fn sides(&self) -> Vec<([u32; 2], u32)> {
        let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(3 * self.triangles.len());
        for (t, v) in self.triangles.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (v[k], v[(k + 1) % 3]);
                sides.push(([a.min(b), a.max(b)], t as u32));
            }
        }
        sides.sort_unstable();
        sides
    }

    /// Neighbours across edges of two triangles.
    fn manifold_neighbours(&self, sides: &[([u32; 2], u32)]) -> Vec<Vec<u32>> {
        let mut neighbours = vec![Vec::new(); self.triangles.len()];
        for same in sides.chunk_by(|a, b| a.0 == b.0) {
            if let [a, b] = same {
                neighbours[a.1 as usize].push(b.1);
                neighbours[b.1 as usize].push(a.1);
            }
        }
        neighbours
    }

    /// Numbers components across edges of two triangles (sheets that meet at an edge of more are components of their own), and
    /// turns triangles over that are wound against those they were reached from; one-sided surfaces keep one seam.
    fn find_components(&mut self, sides: &[([u32; 2], u32)]) {
        let neighbours = self.manifold_neighbours(sides);
        self.component = vec![u32::MAX; self.triangles.len()];
        for first in 0..self.triangles.len() {
            if self.component[first] != u32::MAX {
                continue;
            }
            let mut stack = vec![first as u32];
            while let Some(t) = stack.pop() {
                let own = &mut self.component[t as usize];
                if *own != u32::MAX {
                    continue;
                }
                *own = self.component_count as u32;
                for &u in &neighbours[t as usize] {
                    if self.component[u as usize] == u32::MAX {
                        if runs_alike(&self.triangles[t as usize], &self.triangles[u as usize]) {
                            self.triangles[u as usize].swap(1, 2);
                        }
                        stack.push(u);
                    }
                }
            }
            self.component_count += 1;
        }
    }

    /// Turns closed components over that are inside out, but not those inside another: they are cavities. An open surface
    /// that encloses less than nothing is turned as a whole.
    fn turn_outwards(&mut self, sides: &[([u32; 2], u32)]) {
        let mut open = vec![false; self.component_count];
        for same in sides.chunk_by(|a, b| a.0 == b.0) {
            if same.len() % 2 == 1 {
                same.iter().for_each(|s| open[self.component[s.1 as usize] as usize] = true);
            }
        }
        let middle = 0.5 * (self.bounds[0] + self.bounds[1]);
        let mut volume = vec![0.0; self.component_count];
        for (t, &c) in self.component.iter().enumerate() {
            let [a, b, d] = self.corners(t).map(|p| p - middle);
            volume[c as usize] += a.dot(b.cross(d)) / 6.0;
        }
        let open_volume: f64 = (0..volume.len()).filter(|&c| open[c]).map(|c| volume[c]).sum();
        let turned: Vec<bool> = (0..self.component_count)
            .map(|c| {
                if open[c] { open_volume < 0.0 } else { volume[c] < 0.0 && !self.is_enclosed(c as u32, &open, &volume) }
            })
            .collect();
        for (t, &c) in self.component.iter().enumerate() {
            if turned[c as usize] {
                self.triangles[t].swap(1, 2);
            }
        }
    }

    /// Whether a component lies inside a closed one that is not inside out.
    fn is_enclosed(&self, component: u32, open: &[bool], volume: &[f64]) -> bool {
        let Some(first) = self.component.iter().position(|&c| c == component) else { return false };
        let p = self.positions[self.triangles[first][0] as usize];
        let others = self.component.iter().enumerate();
        let sum: f64 = others
            .filter(|&(_, &c)| c != component && !open[c as usize] && volume[c as usize] > 0.0)
            .map(|(t, _)| super::winding_number::solid_angle(&self.corners(t), p))
            .sum();
        sum > 2.0 * std::f64::consts::PI
    }

    /// Which triangles continue each other across an edge. Where more than two meet, those with solid between them do (bodies that
    /// touch along an edge stay apart), and what is left over holds together.
    fn joined(&self, sides: &[([u32; 2], u32)]) -> Vec<([u32; 2], [u32; 2])> {
        let mut out = Vec::with_capacity(sides.len() / 2);
        for same in sides.chunk_by(|a, b| a.0 == b.0) {
            let edge = same[0].0;
            match same {
                [_] => {}
                [a, b] => out.push(([a.1, b.1], edge)),
                more => {
                    let fan: Vec<u32> = more.iter().map(|s| s.1).collect();
                    out.extend(self.pair_wedges(edge, &fan).into_iter().map(|pair| (pair, edge)));
                }
            }
        }
        out
    }

    fn pair_wedges(&self, edge: [u32; 2], fan: &[u32]) -> Vec<[u32; 2]> {
        let [a, b] = edge.map(|v| self.positions[v as usize]);
        let axis = (b - a).normalize_or_zero();
        let across = |t: u32| {
            let third = self.triangles[t as usize].iter().find(|v| !edge.contains(v));
            let p = third.map_or(a, |&v| self.positions[v as usize]) - a;
            p - axis * axis.dot(p)
        };
        let x = across(fan[0]).normalize_or_zero();
        let y = axis.cross(x);
        // Angle, triangle, whether its solid side lies towards greater angles.
        let mut around: Vec<(f64, u32, bool)> = fan
            .iter()
            .map(|&t| {
                let d = across(t);
                let v = self.corners(t as usize);
                let inwards = -(v[1] - v[0]).cross(v[2] - v[0]);
                (d.dot(y).atan2(d.dot(x)), t, inwards.dot(axis.cross(d)) > 0.0)
            })
            .collect();
        around.sort_by(|p, q| p.0.total_cmp(&q.0).then(p.1.cmp(&q.1)));
        let n = around.len();
        let (mut pairs, mut paired) = (Vec::new(), vec![false; n]);
        for k in 0..n {
            let next = (k + 1) % n;
            if around[k].2 && !around[next].2 && !paired[k] && !paired[next] {
                (paired[k], paired[next]) = (true, true);
                pairs.push([around[k].1, around[next].1]);
            }
        }
        let rest: Vec<u32> = (0..n).filter(|&k| !paired[k]).map(|k| around[k].1).collect();
        pairs.extend(rest.windows(2).map(|w| [w[0], w[1]]));
        if let ([lone], [first, ..]) = (&rest[..], &pairs[..]) {
            pairs.push([*lone, first[0]]);
        }
        pairs
    }
}

/// Whether two triangles at an edge run along it in the same direction: wound against each other.
fn runs_alike(t: &[u32; 3], u: &[u32; 3]) -> bool {
    (0..3).any(|i| (0..3).any(|j| t[i] == u[j] && t[(i + 1) % 3] == u[(j + 1) % 3]))
}

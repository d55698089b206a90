//! The body-centred cubic lattice and its tetrahedra: all of one shape, with dihedral angles of 60° and 90°.
//!
//! Vertices are the corners and the centres of cubes with side `spacing`. Around every face between two cubes stand four tets: the two centres
//! and one edge of the face (Molino et al. 2003). Coordinates are exact integers, in units of half a side.

use glam::DVec3;

/// A BCC lattice in space.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    pub origin: DVec3,
    /// Side of the cubes [model unit].
    pub spacing: f64,
}

/// A vertex: even coordinates are corners of cubes, odd ones centres.
pub(crate) type Point = [i32; 3];

/// A tet: a cube, the axis along which its neighbour lies, the edge of the face between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Cell {
    pub cube: [i32; 3],
    pub axis: u8,
    pub edge: u8,
}

/// Going around a face: corners in units of a side.
const AROUND: [[i32; 2]; 4] = [[0, 0], [1, 0], [1, 1], [0, 1]];

impl Cell {
    /// Its four vertices, positively oriented.
    pub fn vertices(&self) -> [Point; 4] {
        let axis = self.axis as usize;
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let center = self.cube.map(|c| 2 * c + 1);
        let mut next = center;
        next[axis] += 2;
        let corner = |k: usize| {
            let mut p = self.cube.map(|c| 2 * c);
            p[axis] += 2;
            p[u] += 2 * AROUND[k][0];
            p[v] += 2 * AROUND[k][1];
            p
        };
        let e = self.edge as usize;
        [center, next, corner(e), corner((e + 1) % 4)]
    }
}

impl Lattice {
    /// Where a vertex is.
    pub fn position(&self, p: Point) -> DVec3 {
        self.origin + 0.5 * self.spacing * DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))
    }

    /// Corners of a tet.
    pub fn corners(&self, cell: &Cell) -> [DVec3; 4] {
        cell.vertices().map(|p| self.position(p))
    }

    /// Calls `visit` with every tet whose bounding box meets a box.
    pub fn each_cell(&self, lo: DVec3, hi: DVec3, mut visit: impl FnMut(Cell)) {
        let unit = |p: DVec3| ((p - self.origin) / self.spacing).to_array();
        let (lo, hi) = (unit(lo), unit(hi));
        for axis in 0..3usize {
            // Along its axis a tet reaches from half a side into its cube to half a side into the next.
            let shift = |k: usize| if k == axis { 0.5 } else { 0.0 };
            let first = [0, 1, 2].map(|k| (lo[k] - 1.0 - shift(k)).ceil() as i32);
            let last = [0, 1, 2].map(|k| (hi[k] - shift(k)).floor() as i32);
            for x in first[0]..=last[0] {
                for y in first[1]..=last[1] {
                    for z in first[2]..=last[2] {
                        for edge in 0..4 {
                            visit(Cell { cube: [x, y, z], axis: axis as u8, edge });
                        }
                    }
                }
            }
        }
    }
}

/// Barycentric coordinates as an affine map: b(p) = slope · (p − x₃), b₃ = 1 − Σ.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Barycentric {
    last: DVec3,
    slopes: [DVec3; 3],
}

impl Barycentric {
    /// For the corners of a tet that is not flat.
    pub fn new(x: [DVec3; 4]) -> Self {
        let m = glam::DMat3::from_cols(x[0] - x[3], x[1] - x[3], x[2] - x[3]).inverse().transpose();
        Self { last: x[3], slopes: [m.x_axis, m.y_axis, m.z_axis] }
    }

    /// Coordinates of a point.
    pub fn at(&self, p: DVec3) -> [f64; 4] {
        let d = p - self.last;
        let [a, b, c] = self.slopes.map(|s| s.dot(d));
        [a, b, c, 1.0 - a - b - c]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_fill_space_once_are_positively_oriented_and_their_boxes_are_found() {
        let lattice = Lattice { origin: DVec3::new(0.1, 0.2, 0.3), spacing: 0.7 };
        let volume = 0.7f64.powi(3) / 12.0;
        for k in 0..200 {
            let f = |m: f64| ((f64::from(k) + 0.3) * m).fract() * 3.0 - 1.0;
            let p = DVec3::new(f(0.618_034), f(0.414_213_6), f(0.732_050_8));
            let mut inside = 0;
            lattice.each_cell(p, p, |cell| {
                let x = lattice.corners(&cell);
                let v = (x[1] - x[0]).cross(x[2] - x[0]).dot(x[3] - x[0]) / 6.0;
                assert!((v - volume).abs() < 1e-12, "volume {v}");
                inside += usize::from(Barycentric::new(x).at(p).iter().all(|&b| b >= 0.0));
            });
            assert_eq!(inside, 1);
        }
    }
}

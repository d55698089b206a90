//! Surface nets (Gibson 1998): one vertex in each grid cell that the surface crosses, at the mean of the crossings of its
//! edges; one quad around each crossing grid edge, split along its shorter diagonal.

use glam::{DVec3, IVec3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A closed triangle mesh without seams.
pub struct Surface {
    /// Positions [m].
    pub positions: Vec<DVec3>,
    /// Triangles, outward.
    pub triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// Vertices joined by an edge, ascending, per vertex.
    pub fn neighbours(&self) -> Vec<Vec<u32>> {
        let mut out = vec![Vec::new(); self.positions.len()];
        for t in &self.triangles {
            for k in 0..3 {
                out[t[k] as usize].extend([t[(k + 1) % 3], t[(k + 2) % 3]]);
            }
        }
        for row in &mut out {
            row.sort_unstable();
            row.dedup();
        }
        out
    }
}

/// Meshes the zero set of `distance` (negative inside) in the box from `low` to `high`, which must contain it.
pub fn surface(distance: impl Fn(DVec3) -> f64 + Sync, low: DVec3, high: DVec3, cell: f64) -> Surface {
    let n = ((high - low) / cell).ceil().as_ivec3() + IVec3::ONE;
    let point = |i: IVec3| low + i.as_dvec3() * cell;
    let index = |i: IVec3| ((i.z * n.y + i.y) * n.x + i.x) as usize;
    let values: Vec<f64> = (0..n.x * n.y * n.z)
        .into_par_iter()
        .map(|k| distance(point(IVec3::new(k % n.x, k / n.x % n.y, k / (n.x * n.y)))))
        .collect();
    let value = |i: IVec3| values[index(i)];

    let mut vertex_of_cell: BTreeMap<usize, u32> = BTreeMap::new();
    let mut positions = Vec::new();
    for k in 0..(n.x * n.y * n.z) {
        let corner = IVec3::new(k % n.x, k / n.x % n.y, k / (n.x * n.y));
        if (corner + IVec3::ONE).cmpge(n).any() {
            continue;
        }
        if let Some(p) = cell_vertex(corner, &value, &point) {
            vertex_of_cell.insert(index(corner), positions.len() as u32);
            positions.push(p);
        }
    }

    let mut triangles = Vec::new();
    for k in 0..(n.x * n.y * n.z) {
        let i = IVec3::new(k % n.x, k / n.x % n.y, k / (n.x * n.y));
        for axis in 0..3 {
            let step = IVec3::AXES[axis];
            if (i + step).cmpge(n).any() || (value(i) < 0.0) == (value(i + step) < 0.0) {
                continue;
            }
            let (u, v) = (IVec3::AXES[(axis + 1) % 3], IVec3::AXES[(axis + 2) % 3]);
            let mut quad = [i - u - v, i - v, i, i - u].map(|c| vertex_of_cell[&index(c)]);
            if value(i) > 0.0 {
                quad.reverse();
            }
            let x = quad.map(|q| positions[q as usize]);
            if x[0].distance_squared(x[2]) <= x[1].distance_squared(x[3]) {
                triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
            } else {
                triangles.extend([[quad[0], quad[1], quad[3]], [quad[1], quad[2], quad[3]]]);
            }
        }
    }
    Surface { positions, triangles }
}

/// Mean of the surface's crossings with the cell's twelve edges; `None` where it does not cross.
fn cell_vertex(corner: IVec3, value: &impl Fn(IVec3) -> f64, point: &impl Fn(IVec3) -> DVec3) -> Option<DVec3> {
    let (mut sum, mut count) = (DVec3::ZERO, 0.0);
    for axis in 0..3 {
        let (u, v) = (IVec3::AXES[(axis + 1) % 3], IVec3::AXES[(axis + 2) % 3]);
        for start in [corner, corner + u, corner + v, corner + u + v] {
            let end = start + IVec3::AXES[axis];
            let (a, b) = (value(start), value(end));
            if (a < 0.0) != (b < 0.0) {
                sum += point(start).lerp(point(end), a / (a - b));
                count += 1.0;
            }
        }
    }
    (count > 0.0).then(|| sum / count)
}

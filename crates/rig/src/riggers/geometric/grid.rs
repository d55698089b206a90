//! A regular grid over a box, and what of a triangle soup lies in its voxels.

use animimic_scene::solid::{Soup, WindingNumber};
use glam::DVec3;
use rayon::prelude::*;

/// Voxels of outside kept around everything, so that neighbours always exist.
const MARGIN: usize = 2;

/// Voxels of a block's side whose winding number is asked once where no surface is near.
const BLOCKS: [usize; 2] = [4, 2];

/// A winding number this far from one half decides for a whole block.
const SURE: f64 = 0.25;

/// A regular grid of cubes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    /// Corner of voxel 0.
    pub origin: DVec3,
    /// Side of a voxel [model unit].
    pub spacing: f64,
    /// Voxels along each axis.
    pub size: [usize; 3],
}

impl Grid {
    /// A grid over a box. Along `mirror` (an axis and a coordinate) a border between voxels lies in that plane.
    pub fn over(bounds: [DVec3; 2], spacing: f64, mirror: Option<(usize, f64)>) -> Self {
        let mut origin = bounds[0] - DVec3::splat(MARGIN as f64 * spacing);
        if let Some((axis, at)) = mirror {
            origin[axis] = at - ((at - origin[axis]) / spacing).ceil() * spacing;
        }
        let size = ((bounds[1] - origin) / spacing).to_array().map(|n| n.floor().max(0.0) as usize + 1 + MARGIN);
        Self { origin, spacing, size }
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.size.iter().product()
    }

    /// Steps in the numbering along each axis.
    pub fn strides(&self) -> [usize; 3] {
        [1, self.size[0], self.size[0] * self.size[1]]
    }

    /// Number of a voxel.
    pub fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.size[0] * (y + self.size[1] * z)
    }

    /// The voxel of a number.
    pub fn voxel(&self, i: usize) -> [usize; 3] {
        [i % self.size[0], i / self.size[0] % self.size[1], i / (self.size[0] * self.size[1])]
    }

    /// Centre of a voxel.
    pub fn center(&self, i: usize) -> DVec3 {
        let [x, y, z] = self.voxel(i);
        self.origin + self.spacing * (DVec3::new(x as f64, y as f64, z as f64) + 0.5)
    }

    /// The voxel that holds a point, the nearest one for points outside.
    pub fn at(&self, p: DVec3) -> [usize; 3] {
        let q = ((p - self.origin) / self.spacing).to_array();
        // Casts saturate: what lies before the first voxel is in it.
        std::array::from_fn(|k| (q[k] as usize).min(self.size[k] - 1))
    }

    /// Marks the voxels that triangles cross.
    pub fn crossed(&self, soup: &Soup) -> Vec<bool> {
        let mut out = vec![false; self.len()];
        for t in 0..soup.triangles.len() {
            let corners = soup.corners(t);
            let lo = self.at(corners[0].min(corners[1]).min(corners[2]));
            let hi = self.at(corners[0].max(corners[1]).max(corners[2]));
            for z in lo[2]..=hi[2] {
                for y in lo[1]..=hi[1] {
                    for x in lo[0]..=hi[0] {
                        let i = self.index([x, y, z]);
                        if !out[i] && meets(corners.map(|p| p - self.center(i)), 0.5 * self.spacing) {
                            out[i] = true;
                        }
                    }
                }
            }
        }
        out
    }

    /// Marks the voxels whose centres the surface encloses.
    pub fn enclosed(&self, winding: &WindingNumber, crossed: &[bool]) -> Vec<bool> {
        let inside = |p: DVec3| winding.at(p).total;
        let layer = self.size[0] * self.size[1];
        let thick = BLOCKS[0];
        let mut out = vec![false; self.len()];
        out.par_chunks_mut(layer * thick).enumerate().for_each(|(k, slab)| {
            let z0 = k * thick;
            let depth = slab.len() / layer;
            let mut fill = |lo: [usize; 3], hi: [usize; 3], value: bool| {
                for z in lo[2]..hi[2] {
                    for y in lo[1]..hi[1] {
                        let row = self.index([0, y, z]) - z0 * layer;
                        slab[row + lo[0]..row + hi[0]].fill(value);
                    }
                }
            };
            let end = [self.size[0], self.size[1], z0 + depth];
            for y in (0..end[1]).step_by(thick) {
                for x in (0..end[0]).step_by(thick) {
                    self.fill_block([x, y, z0], 0, end, crossed, &inside, &mut fill);
                }
            }
        });
        // Soups may wind around points of the margin; what is there is outside by definition.
        for (i, inside) in out.iter_mut().enumerate() {
            let v = self.voxel(i);
            *inside &= (0..3).all(|k| v[k] > 0 && v[k] + 1 < self.size[k]);
        }
        out
    }

    /// Asks for a block as a whole where no surface is near and the answer is clear, else for its parts.
    fn fill_block(
        &self,
        lo: [usize; 3],
        level: usize,
        end: [usize; 3],
        crossed: &[bool],
        inside: &(impl Fn(DVec3) -> f64 + Sync),
        fill: &mut impl FnMut([usize; 3], [usize; 3], bool),
    ) {
        let side = BLOCKS.get(level).copied().unwrap_or(1);
        let hi: [usize; 3] = std::array::from_fn(|k| (lo[k] + side).min(end[k]));
        if (0..3).any(|k| lo[k] >= hi[k]) {
            return;
        }
        let free =
            (lo[2]..hi[2]).all(|z| (lo[1]..hi[1]).all(|y| (lo[0]..hi[0]).all(|x| !crossed[self.index([x, y, z])])));
        if side == 1 || free {
            let middle = self.center(self.index(lo)) + 0.5 * (side as f64 - 1.0) * self.spacing;
            let w = inside(middle);
            if side == 1 || (w - 0.5).abs() > SURE {
                fill(lo, hi, w > 0.5);
                return;
            }
        }
        let step = BLOCKS.get(level + 1).copied().unwrap_or(1);
        for z in (lo[2]..hi[2]).step_by(step) {
            for y in (lo[1]..hi[1]).step_by(step) {
                for x in (lo[0]..hi[0]).step_by(step) {
                    self.fill_block([x, y, z], level + 1, end, crossed, inside, fill);
                }
            }
        }
    }

    /// Squared distance in voxels from every voxel's centre to the nearest one outside `solid`, exact (Felzenszwalb and
    /// Huttenlocher 2012): lower envelopes of parabolas, axis after axis.
    pub fn squared_depth(&self, solid: &[bool]) -> Vec<f32> {
        let mut field: Vec<f32> = solid.iter().map(|&s| if s { f32::MAX } else { 0.0 }).collect();
        let strides = self.strides();
        for axis in 0..3 {
            let (n, stride) = (self.size[axis], strides[axis]);
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let starts: Vec<usize> = (0..self.size[v])
                .flat_map(|b| (0..self.size[u]).map(move |a| (a, b)))
                .map(|(a, b)| a * strides[u] + b * strides[v])
                .collect();
            let (mut row, mut out) = (vec![0.0f32; n], vec![0.0f32; n]);
            let mut hull = Hull::default();
            for start in starts {
                (0..n).for_each(|k| row[k] = field[start + k * stride]);
                if row.iter().all(|&f| f == 0.0) {
                    continue;
                }
                hull.envelope(&row, &mut out);
                (0..n).for_each(|k| field[start + k * stride] = out[k]);
            }
        }
        field
    }
}

/// Lower envelope of parabolas, its memory kept between rows.
#[derive(Default)]
struct Hull {
    places: Vec<usize>,
    from: Vec<f32>,
}

impl Hull {
    fn envelope(&mut self, f: &[f32], out: &mut [f32]) {
        self.places.clear();
        self.from.clear();
        for q in (0..f.len()).filter(|&q| f[q] < f32::MAX) {
            loop {
                let Some(&p) = self.places.last() else {
                    self.places.push(q);
                    self.from.push(f32::NEG_INFINITY);
                    break;
                };
                let (a, b) = (q as f32, p as f32);
                let s = ((f[q] + a * a) - (f[p] + b * b)) / (2.0 * (a - b));
                if s > self.from[self.from.len() - 1] {
                    self.places.push(q);
                    self.from.push(s);
                    break;
                }
                self.places.pop();
                self.from.pop();
            }
        }
        if self.places.is_empty() {
            out.fill(f32::MAX);
            return;
        }
        let mut k = 0;
        for (q, value) in out.iter_mut().enumerate() {
            while k + 1 < self.places.len() && self.from[k + 1] < q as f32 {
                k += 1;
            }
            let d = q as f32 - self.places[k] as f32;
            *value = d * d + f[self.places[k]];
        }
    }
}

/// Whether a triangle meets a cube about the origin (separating axes, Akenine-Möller 2001).
fn meets(t: [DVec3; 3], half: f64) -> bool {
    let outside = |axis: DVec3| {
        let d = t.map(|p| p.dot(axis));
        let reach = half * axis.abs().element_sum();
        d[0].min(d[1]).min(d[2]) > reach || d[0].max(d[1]).max(d[2]) < -reach
    };
    let edges = [t[1] - t[0], t[2] - t[1], t[0] - t[2]];
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    !(axes.into_iter().any(outside)
        || outside(edges[0].cross(edges[1]))
        || edges.iter().any(|e| axes.iter().any(|a| outside(a.cross(*e)))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_are_distances_to_the_nearest_voxel_outside() {
        let grid = Grid { origin: DVec3::ZERO, spacing: 1.0, size: [13, 11, 9] };
        let solid: Vec<bool> = (0..grid.len())
            .map(|i| {
                let [x, y, z] = grid.voxel(i);
                (1..12).contains(&x) && (1..10).contains(&y) && (1..8).contains(&z) && (x * 7 + y * 5 + z * 3) % 31 != 0
            })
            .collect();
        let depth = grid.squared_depth(&solid);
        for i in 0..grid.len() {
            let nearest = (0..grid.len())
                .filter(|&k| !solid[k])
                .map(|k| grid.center(i).distance_squared(grid.center(k)))
                .fold(f64::INFINITY, f64::min);
            assert_eq!(f64::from(depth[i]), nearest, "voxel {i}");
        }
    }

    #[test]
    fn a_triangle_meets_the_cubes_that_hold_points_of_it_and_no_far_ones() {
        let t = [DVec3::new(0.2, 0.1, 0.3), DVec3::new(3.1, 0.4, 0.9), DVec3::new(0.7, 2.6, 2.2)];
        let grid = Grid { origin: DVec3::splat(-1.0), spacing: 0.4, size: [13, 13, 13] };
        for i in 0..grid.len() {
            let c = grid.center(i);
            let mut nearest = f64::INFINITY;
            for a in 0..=60 {
                for b in 0..=60 - a {
                    let (u, v) = (f64::from(a) / 60.0, f64::from(b) / 60.0);
                    let d = t[0] + u * (t[1] - t[0]) + v * (t[2] - t[0]) - c;
                    nearest = nearest.min(d.abs().max_element());
                }
            }
            let met = meets(t.map(|p| p - c), 0.2);
            assert!(met || nearest > 0.2, "voxel {i}: a point of the triangle is inside");
            assert!(!met || nearest < 0.25, "voxel {i}: {nearest}");
        }
    }
}

//! A coarse stand-in for a dense model: same skeleton, same looks, fewer triangles.
//!
//! Quadric edge collapse (Garland & Heckbert 1997, "Surface simplification using quadric error metrics", eqs 1–2): the cost
//! of moving a onto b is x_bᵀ (Q_a + Q_b) x_b, Q_v the sum of squared distances to the planes of v's triangles, weighted by
//! area. Where we differ: vertices only ever move onto other vertices, so that what remains keeps its own texture
//! coordinates, normals and skin weights, and a pose of the stand-in is a pose of the model; open borders and seams of
//! texture get planes of their own across the surface.
//! Seams: a corner moves to the corner at b that shares a triangle with it; where none does (normals split at every face),
//! to the one in the same part with the nearest texture coordinates, or the collapse is refused.

use animimic_scene::{Asset, Mesh, Part, Rig, Skin, Source};
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Weight of the planes that hold borders, against the surface's own.
const BORDER_WEIGHT: f64 = 10.0;
/// Cost of an edge's squared length, against squared distances to planes: where all is flat, short edges go first.
const LENGTH_WEIGHT: f64 = 1e-4;
/// Cosine between a triangle's normals before and after, below which it counts as folded.
const FOLD_COSINE: f64 = 0.3;
/// Texture coordinates farther apart than this are not the same place of the texture.
const UV_REACH: f64 = 0.03;

/// A stand-in with about `triangles` triangles, or `None` where the model has no more than that.
pub fn proxy(asset: &Asset, triangles: usize) -> Option<Asset> {
    if asset.mesh.triangles.len() <= triangles {
        return None;
    }
    let mut collapse = Collapse::new(&asset.mesh);
    collapse.run(triangles);
    Some(collapse.extract(asset))
}

/// Symmetric 4×4 form of Σ w (nᵀx + d)²: A = Σ w n nᵀ (upper triangle), b = Σ w d n, c = Σ w d².
#[derive(Clone, Copy, Debug, Default)]
struct Quadric {
    a: [f64; 6],
    b: DVec3,
    c: f64,
}

impl Quadric {
    fn plane(n: DVec3, point: DVec3, weight: f64) -> Self {
        let d = -n.dot(point);
        let a = [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z].map(|v| v * weight);
        Self { a, b: n * (d * weight), c: d * d * weight }
    }

    fn add(&mut self, other: &Self) {
        self.a.iter_mut().zip(other.a).for_each(|(a, b)| *a += b);
        self.b += other.b;
        self.c += other.c;
    }

    fn at(&self, x: DVec3) -> f64 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let quadratic = xx * x.x * x.x + yy * x.y * x.y + zz * x.z * x.z;
        let mixed = xy * x.x * x.y + xz * x.x * x.z + yz * x.y * x.z;
        (quadratic + 2.0 * mixed + 2.0 * self.b.dot(x) + self.c).max(0.0)
    }
}

/// A collapse that may be done: from → onto, if neither changed since.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Candidate {
    cost: f64,
    from: u32,
    onto: u32,
    stamps: [u32; 2],
}

impl Eq for Candidate {}

impl Ord for Candidate {
    /// Cheapest first in a max-heap; ties by index, so that the result does not depend on the heap's history.
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then(other.from.cmp(&self.from)).then(other.onto.cmp(&self.onto))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

struct Collapse<'a> {
    mesh: &'a Mesh,
    /// File vertices; corners move as vertices collapse.
    triangles: Vec<[u32; 3]>,
    alive: Vec<bool>,
    live: usize,
    /// Position of each welded vertex.
    place: Vec<DVec3>,
    /// Live triangles at each welded vertex; may hold dead ones until it is next touched.
    around: Vec<Vec<u32>>,
    quadric: Vec<Quadric>,
    stamp: Vec<u32>,
    gone: Vec<bool>,
    part_of: Vec<u32>,
    heap: BinaryHeap<Candidate>,
}

impl<'a> Collapse<'a> {
    fn new(mesh: &'a Mesh) -> Self {
        let count = mesh.welded_count;
        let mut place = vec![DVec3::ZERO; count];
        mesh.welded.iter().zip(&mesh.positions).for_each(|(&w, &p)| place[w as usize] = p);
        let mut around = vec![Vec::new(); count];
        let welded = |t: &[u32; 3]| t.map(|v| mesh.welded[v as usize]);
        let whole = |w: [u32; 3]| w[0] != w[1] && w[1] != w[2] && w[2] != w[0];
        let alive: Vec<bool> = mesh.triangles.iter().map(|t| whole(welded(t))).collect();
        for (i, t) in mesh.triangles.iter().enumerate().filter(|(i, _)| alive[*i]) {
            welded(t).iter().for_each(|&w| around[w as usize].push(i as u32));
        }
        let mut part_of = vec![0; mesh.positions.len()];
        for (i, part) in mesh.parts.iter().enumerate() {
            part_of[part.vertices.clone()].fill(i as u32);
        }
        let mut this = Self {
            mesh,
            triangles: mesh.triangles.clone(),
            live: alive.iter().filter(|a| **a).count(),
            alive,
            place,
            around,
            quadric: vec![Quadric::default(); count],
            stamp: vec![0; count],
            gone: vec![false; count],
            part_of,
            heap: BinaryHeap::new(),
        };
        this.planes();
        for v in 0..count as u32 {
            this.push_edges(v, |a, b| a < b);
        }
        this
    }

    fn corners(&self, triangle: u32) -> [u32; 3] {
        self.triangles[triangle as usize].map(|v| self.mesh.welded[v as usize])
    }

    fn places(&self, triangle: u32) -> [DVec3; 3] {
        self.corners(triangle).map(|w| self.place[w as usize])
    }

    /// Surface planes, and planes across the surface at borders and seams.
    fn planes(&mut self) {
        let mut edges: Vec<([u32; 2], [u32; 2], u32)> = Vec::with_capacity(3 * self.triangles.len());
        for i in (0..self.triangles.len() as u32).filter(|&i| self.alive[i as usize]) {
            let (w, p) = (self.corners(i), self.places(i));
            let n = (p[1] - p[0]).cross(p[2] - p[0]);
            let q = Quadric::plane(n.normalize_or_zero(), p[0], 0.5 * n.length());
            w.iter().for_each(|&v| self.quadric[v as usize].add(&q));
            let f = self.triangles[i as usize];
            for k in 0..3 {
                let (a, b) = (k, (k + 1) % 3);
                let (a, b) = if w[a] < w[b] { (a, b) } else { (b, a) };
                edges.push(([w[a], w[b]], [f[a], f[b]], i));
            }
        }
        edges.sort_unstable();
        for same in edges.chunk_by(|a, b| a.0 == b.0) {
            let seam = same.len() != 2 || !self.same_texture(same[0].1, same[1].1);
            if !seam {
                continue;
            }
            for &(ends, _, triangle) in same {
                let p = self.places(triangle);
                let n = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
                let [a, b] = ends.map(|w| self.place[w as usize]);
                let across = (b - a).cross(n).normalize_or_zero();
                let q = Quadric::plane(across, a, BORDER_WEIGHT * (b - a).length_squared());
                ends.iter().for_each(|&w| self.quadric[w as usize].add(&q));
            }
        }
    }

    /// Whether two file edges at one place show the same part and place of the texture.
    fn same_texture(&self, a: [u32; 2], b: [u32; 2]) -> bool {
        (0..2).all(|k| {
            let (i, j) = (a[k] as usize, b[k] as usize);
            self.part_of[i] == self.part_of[j]
                && self.mesh.uvs.get(i).zip(self.mesh.uvs.get(j)).is_none_or(|(u, v)| u.distance(*v) < 1e-4)
        })
    }

    /// Welded neighbours of a vertex, ascending.
    fn neighbours(&self, v: u32) -> Vec<u32> {
        let live = self.around[v as usize].iter().filter(|&&t| self.alive[t as usize]);
        let mut all: Vec<u32> = live.flat_map(|&t| self.corners(t)).filter(|&w| w != v).collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    fn push_edges(&mut self, v: u32, wanted: impl Fn(u32, u32) -> bool) {
        for w in self.neighbours(v) {
            if wanted(v, w) {
                self.push(v, w);
                self.push(w, v);
            }
        }
    }

    fn push(&mut self, from: u32, onto: u32) {
        let (a, b) = (from as usize, onto as usize);
        let x = self.place[b];
        let length2 = x.distance_squared(self.place[a]);
        let cost = self.quadric[a].at(x) + self.quadric[b].at(x) + LENGTH_WEIGHT * length2 * length2;
        self.heap.push(Candidate { cost, from, onto, stamps: [self.stamp[a], self.stamp[b]] });
    }

    fn run(&mut self, wanted: usize) {
        while self.live > wanted {
            let Some(c) = self.heap.pop() else { break };
            let fresh = [c.from, c.onto].iter().zip(c.stamps).all(|(&v, s)| self.stamp[v as usize] == s);
            if fresh
                && !self.gone[c.from as usize]
                && !self.gone[c.onto as usize]
                && let Some(moves) = self.allowed(c.from, c.onto)
            {
                self.collapse(c.from, c.onto, &moves);
            }
        }
    }

    /// What happens to each triangle around `from`: (triangle, corner, new file vertex); `None` if it must not be.
    fn allowed(&self, from: u32, onto: u32) -> Option<Vec<(u32, usize, u32)>> {
        let at = |v: u32| self.around[v as usize].iter().copied().filter(|&t| self.alive[t as usize]);
        let shared: Vec<u32> = at(from).filter(|&t| self.corners(t).contains(&onto)).collect();
        let (a, b) = (self.neighbours(from), self.neighbours(onto));
        // Link condition: more common neighbours than shared triangles would pinch the surface.
        if a.iter().filter(|v| b.binary_search(v).is_ok()).count() > shared.len() {
            return None;
        }
        // A border vertex may only move along its border.
        if shared.len() != 1 && a.len() > at(from).count() {
            return None;
        }
        let pairs: Vec<(u32, u32)> =
            shared.iter().filter_map(|&t| Some((self.file_vertex(t, from)?, self.file_vertex(t, onto)?))).collect();
        let mut moves = Vec::new();
        for t in at(from).filter(|t| !shared.contains(t)) {
            let k = self.corners(t).iter().position(|&w| w == from)?;
            let p = self.places(t);
            let mut q = p;
            q[k] = self.place[onto as usize];
            let normal = |p: [DVec3; 3]| (p[1] - p[0]).cross(p[2] - p[0]);
            let (before, after) = (normal(p), normal(q));
            if before.dot(after) <= FOLD_COSINE * before.length() * after.length() {
                return None;
            }
            let corner = self.triangles[t as usize][k];
            let next = match pairs.iter().find(|(x, _)| *x == corner) {
                Some((_, y)) => *y,
                None => self.nearest_corner(corner, at(onto).filter_map(|t| self.file_vertex(t, onto)))?,
            };
            moves.push((t, k, next));
        }
        Some(moves)
    }

    fn file_vertex(&self, triangle: u32, welded: u32) -> Option<u32> {
        self.triangles[triangle as usize].into_iter().find(|&v| self.mesh.welded[v as usize] == welded)
    }

    /// The corner that looks most like another: same part, near in texture, then alike in normal.
    fn nearest_corner(&self, corner: u32, candidates: impl Iterator<Item = u32>) -> Option<u32> {
        let m = self.mesh;
        let i = corner as usize;
        candidates
            .filter(|&j| self.part_of[j as usize] == self.part_of[i])
            .map(|j| {
                let uv = m.uvs.get(i).zip(m.uvs.get(j as usize)).map_or(0.0, |(a, b)| a.distance(*b));
                let turn = m.normals.get(i).zip(m.normals.get(j as usize)).map_or(0.0, |(a, b)| 1.0 - a.dot(*b));
                (uv, uv + UV_REACH * turn, j)
            })
            .filter(|c| c.0 <= UV_REACH)
            .min_by(|a, b| a.1.total_cmp(&b.1).then(a.2.cmp(&b.2)))
            .map(|c| c.2)
    }

    fn collapse(&mut self, from: u32, onto: u32, moves: &[(u32, usize, u32)]) {
        let (a, b) = (from as usize, onto as usize);
        for &(t, k, corner) in moves {
            self.triangles[t as usize][k] = corner;
        }
        for t in std::mem::take(&mut self.around[a]) {
            if !self.alive[t as usize] {
                continue;
            }
            if moves.iter().any(|m| m.0 == t) {
                self.around[b].push(t);
            } else {
                self.alive[t as usize] = false;
                self.live -= 1;
            }
        }
        let alive = &self.alive;
        self.around[b].retain(|&t| alive[t as usize]);
        self.gone[a] = true;
        let q = self.quadric[a];
        self.quadric[b].add(&q);
        self.stamp[b] += 1;
        self.push_edges(onto, |_, _| true);
    }

    /// The asset with what is left.
    fn extract(&self, asset: &Asset) -> Asset {
        let m = self.mesh;
        let mut used = vec![false; m.positions.len()];
        let live = |i: &usize| self.alive[*i];
        (0..self.triangles.len()).filter(live).for_each(|i| {
            self.triangles[i].iter().for_each(|&v| used[v as usize] = true);
        });
        let kept: Vec<usize> = (0..used.len()).filter(|&v| used[v]).collect();
        let before = |flags: &[bool]| -> Vec<usize> {
            std::iter::once(0)
                .chain(flags.iter().scan(0, |n, &f| {
                    *n += usize::from(f);
                    Some(*n)
                }))
                .collect()
        };
        let (vertex, triangle) = (before(&used), before(&self.alive));
        let pick = |values: &[DVec3]| -> Vec<DVec3> { kept.iter().filter_map(|&v| values.get(v).copied()).collect() };
        let positions = pick(&m.positions);
        let mut welded_ids = vec![u32::MAX; m.welded_count];
        let mut welded_count = 0;
        let welded = kept
            .iter()
            .map(|&v| {
                let id = &mut welded_ids[m.welded[v] as usize];
                if *id == u32::MAX {
                    *id = welded_count;
                    welded_count += 1;
                }
                *id
            })
            .collect();
        let part = |p: &Part| Part {
            vertices: vertex[p.vertices.start]..vertex[p.vertices.end],
            triangles: triangle[p.triangles.start]..triangle[p.triangles.end],
            ..p.clone()
        };
        let mesh = Mesh {
            normals: pick(&m.normals),
            uvs: kept.iter().filter_map(|&v| m.uvs.get(v).copied()).collect(),
            colors: kept.iter().filter_map(|&v| m.colors.get(v).copied()).collect(),
            youngs: kept.iter().filter_map(|&v| m.youngs.get(v).copied()).collect(),
            triangles: (0..self.triangles.len())
                .filter(live)
                .map(|i| self.triangles[i].map(|v| vertex[v as usize] as u32))
                .collect(),
            parts: m.parts.iter().map(part).collect(),
            positions,
            welded,
            welded_count: welded_count as usize,
        };
        let skin = &asset.rig.skin;
        let skin = Skin {
            slots: skin.slots.clone(),
            bind_positions: pick(&skin.bind_positions),
            influences: kept.iter().filter_map(|&v| skin.influences.get(v).cloned()).collect(),
        };
        Asset {
            mesh,
            looks: asset.looks.clone(),
            rig: Rig { skeleton: asset.rig.skeleton.clone(), skin },
            motions: Vec::new(),
            source: Source::Plain,
            warnings: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_scene::{Influence, Look};
    use glam::DVec2;

    /// A sphere in latitude and longitude with a texture seam, skinned by height.
    fn globe(rings: usize, sectors: usize) -> Asset {
        let mut mesh = Mesh::default();
        for r in 0..=rings {
            for s in 0..=sectors {
                let (u, v) = (s as f64 / sectors as f64, r as f64 / rings as f64);
                // The seam must meet itself to the bit.
                let (a, b) = ((s % sectors) as f64 / sectors as f64 * std::f64::consts::TAU, v * std::f64::consts::PI);
                mesh.positions.push(DVec3::new(b.sin() * a.cos(), b.cos(), b.sin() * a.sin()));
                mesh.uvs.push(DVec2::new(u, v));
            }
        }
        let at = |r: usize, s: usize| (r * (sectors + 1) + s) as u32;
        for r in 0..rings {
            for s in 0..sectors {
                mesh.triangles.push([at(r, s), at(r + 1, s), at(r, s + 1)]);
                mesh.triangles.push([at(r, s + 1), at(r + 1, s), at(r + 1, s + 1)]);
            }
        }
        let mut places: Vec<DVec3> = Vec::new();
        let mut known = std::collections::BTreeMap::new();
        mesh.welded = mesh
            .positions
            .iter()
            .map(|p| {
                let key = p.to_array().map(|c| (c * 1e9).round() as i64);
                *known.entry(key).or_insert_with(|| {
                    places.push(*p);
                    places.len() as u32 - 1
                })
            })
            .collect();
        mesh.welded_count = places.len();
        let (vertices, triangles) = (0..mesh.positions.len(), 0..mesh.triangles.len());
        mesh.parts = vec![Part { vertices, triangles, ..Part::default() }];
        let skin = Skin {
            bind_positions: mesh.positions.clone(),
            influences: mesh.positions.iter().map(|p| vec![Influence { slot: 0, weight: p.y }]).collect(),
            ..Skin::default()
        };
        Asset { mesh, looks: vec![Look::default()], rig: Rig { skin, ..Rig::default() }, ..Asset::default() }
    }

    #[test]
    fn a_globe_stays_round_and_keeps_texture_and_weights() {
        let asset = globe(60, 120);
        let small = proxy(&asset, 1500).unwrap();
        let m = &small.mesh;
        println!("{} → {} triangles", asset.mesh.triangles.len(), m.triangles.len());
        assert!(m.triangles.len() <= 1500 && m.parts[0].triangles == (0..m.triangles.len()));
        let volume = |m: &Mesh| -> f64 {
            let six: f64 = m
                .triangles
                .iter()
                .map(|t| {
                    let [a, b, c] = t.map(|v| m.positions[v as usize]);
                    a.dot(b.cross(c))
                })
                .sum();
            (six / 6.0).abs()
        };
        let (whole, left) = (volume(&asset.mesh), volume(m));
        println!("volume {whole:.4} → {left:.4}");
        assert!((left / whole - 1.0).abs() < 0.02);
        // No triangle spans the texture's seam, and attributes still belong to positions.
        for t in &m.triangles {
            let u = t.map(|v| m.uvs[v as usize].x);
            let v = t.map(|v| m.positions[v as usize]);
            let pole = v.iter().any(|p| p.y.abs() > 0.95);
            let span = u.iter().fold(0.0f64, |s, a| u.iter().fold(s, |s, b| s.max((a - b).abs())));
            assert!(pole || span < 0.5, "{u:?}");
        }
        for (i, p) in m.positions.iter().enumerate() {
            assert_eq!(small.rig.skin.influences[i][0].weight, p.y);
            assert!(((m.uvs[i].y * std::f64::consts::PI).cos() - p.y).abs() < 1e-9);
        }
    }

    #[test]
    fn an_open_sheet_keeps_its_outline() {
        let mut asset = globe(40, 40);
        let n = 41;
        for (i, p) in asset.mesh.positions.iter_mut().enumerate() {
            *p = DVec3::new((i % n) as f64, (i / n) as f64, 0.0);
        }
        asset.mesh.welded = (0..asset.mesh.positions.len() as u32).collect();
        asset.mesh.welded_count = asset.mesh.positions.len();
        let m = proxy(&asset, 200).unwrap().mesh;
        let area: f64 = m
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| m.positions[v as usize]);
                0.5 * (b - a).cross(c - a).length()
            })
            .sum();
        println!("{} triangles, area {area} of 1600", m.triangles.len());
        assert!(m.triangles.len() <= 200 && (area - 1600.0).abs() < 1e-6);
    }

    #[test]
    fn small_models_have_no_stand_in() {
        assert!(proxy(&globe(8, 8), 1000).is_none());
    }
}

//! Shading normals of a posed surface.
//!
//! Where the file has normals, vertices that share a position *and* (nearly) a normal form one group; a group's posed normal
//! is the area-weighted sum r of its triangles' normals, so hard edges of the file stay hard and smooth ones smooth. What
//! the file's normal n₀ differed from r at rest is kept as coordinates in the frame (r, t, r × t), t an edge made
//! perpendicular to r: n = a·r + b·t + c·(r × t). At rest this is the file's normal exactly, and it turns with the surface.
//! Where the file has none, triangles are flat (glTF 2.0, 3.7.2.1).

use animimic_scene::Mesh;
use glam::DVec3;

/// Cosine above which two file normals at one point count as one (2.6°): quantised normals differ by less, creases by more.
const SAME_NORMAL: f64 = 0.999;

/// Cosine above which the file's normal is taken to be the area-weighted one (0.08°).
const AREA_WEIGHTED: f64 = 1.0 - 1e-6;

/// How normals follow from positions; built once per mesh.
#[derive(Clone, Debug, Default)]
pub struct NormalRecipe {
    /// Vertex → group; empty for flat shading.
    group: Vec<u32>,
    groups: usize,
    /// File normal in the group's frame, per vertex.
    coordinates: Vec<DVec3>,
    /// Per group: an edge (vertex, vertex) that spans the frame together with the normal.
    edge: Vec<[u32; 2]>,
}

impl Default for Normals {
    fn default() -> Self {
        Self::Flat(Vec::new())
    }
}

/// Normals of a pose.
#[derive(Clone, Debug, PartialEq)]
pub enum Normals {
    /// Unit normal per vertex.
    Smooth(Vec<DVec3>),
    /// Unit normal per triangle.
    Flat(Vec<DVec3>),
}

impl NormalRecipe {
    /// Finds groups and frames for a mesh in its rest pose.
    pub fn new(mesh: &Mesh) -> Self {
        let n = mesh.positions.len();
        if mesh.normals.len() != n || n == 0 {
            return Self::default();
        }
        let mut recipe = Self { group: vec![0; n], ..Self::default() };
        recipe.group_vertices(mesh);
        recipe.find_frames(mesh);
        recipe
    }

    /// The recipe of a part: `vertices` are those it has, by their number in the whole, and `number` is the opposite.
    pub(crate) fn part(&self, vertices: &[usize], number: impl Fn(u32) -> Option<u32>) -> Self {
        if self.is_flat() {
            return Self::default();
        }
        let mut groups: Vec<u32> = vertices.iter().map(|&v| self.group[v]).collect();
        groups.sort_unstable();
        groups.dedup();
        let group = |v: &usize| groups.partition_point(|&g| g < self.group[*v]) as u32;
        let edge = |&g: &u32| {
            let [a, b] = self.edge[g as usize];
            number(a).zip(number(b)).map_or([0, 0], |(a, b)| [a, b])
        };
        Self {
            group: vertices.iter().map(group).collect(),
            groups: groups.len(),
            coordinates: vertices.iter().map(|&v| self.coordinates[v]).collect(),
            edge: groups.iter().map(edge).collect(),
        }
    }

    /// Whether each triangle shares a normal with one of those `chosen`.
    pub(crate) fn beside(&self, triangles: &[[u32; 3]], chosen: &[bool]) -> Vec<bool> {
        if self.is_flat() {
            return chosen.to_vec();
        }
        let mut touched = vec![false; self.groups];
        for (corners, _) in triangles.iter().zip(chosen).filter(|(_, c)| **c) {
            self.groups_of(corners).into_iter().flatten().for_each(|g| touched[g] = true);
        }
        triangles.iter().map(|c| self.groups_of(c).into_iter().flatten().any(|g| touched[g])).collect()
    }

    /// Whether triangles are flat.
    pub fn is_flat(&self) -> bool {
        self.group.is_empty()
    }

    fn group_vertices(&mut self, mesh: &Mesh) {
        let mut order: Vec<usize> = (0..mesh.positions.len()).collect();
        let weld = |v: usize| mesh.welded.get(v).map_or(v, |&w| w as usize);
        order.sort_by_key(|&v| (weld(v), v));
        let mut open: Vec<(DVec3, u32)> = Vec::new();
        let mut point = usize::MAX;
        for v in order {
            if weld(v) != point {
                point = weld(v);
                open.clear();
            }
            let normal = mesh.normals[v];
            let known = open.iter().find(|(n, _)| n.dot(normal) > SAME_NORMAL).map(|&(_, g)| g);
            self.group[v] = known.unwrap_or_else(|| {
                open.push((normal, self.groups as u32));
                self.groups += 1;
                self.groups as u32 - 1
            });
        }
    }

    fn find_frames(&mut self, mesh: &Mesh) {
        self.edge = vec![[0, 0]; self.groups];
        for corners in &mesh.triangles {
            for k in 0..3 {
                let edge = &mut self.edge[self.group[corners[k] as usize] as usize];
                if edge[0] == edge[1] {
                    *edge = [corners[k], corners[(k + 1) % 3]];
                }
            }
        }
        let sums = self.group_sums(&mesh.positions, &mesh.triangles);
        self.coordinates = (0..mesh.positions.len())
            .map(|v| {
                let group = self.group[v] as usize;
                let r = sums[group].normalize_or_zero();
                let n = mesh.normals[v];
                if n.dot(r) > AREA_WEIGHTED || r == DVec3::ZERO || !n.is_finite() {
                    return DVec3::X;
                }
                let t = self.tangent(&mesh.positions, group, r);
                DVec3::new(n.dot(r), n.dot(t), n.dot(r.cross(t)))
            })
            .collect();
    }

    fn tangent(&self, positions: &[DVec3], group: usize, r: DVec3) -> DVec3 {
        let [a, b] = self.edge[group];
        let e = positions[b as usize] - positions[a as usize];
        (e - r * r.dot(e)).normalize_or_zero()
    }

    /// Σ of (area-weighted, ×2) triangle normals per group; a triangle counts once per group it touches.
    fn group_sums(&self, positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
        let mut sums = vec![DVec3::ZERO; self.groups];
        for corners in triangles {
            let n = face_normal(positions, corners);
            for g in self.groups_of(corners).into_iter().flatten() {
                sums[g] += n;
            }
        }
        sums
    }

    fn groups_of(&self, corners: &[u32; 3]) -> [Option<usize>; 3] {
        let g = corners.map(|c| self.group[c as usize] as usize);
        [Some(g[0]), (g[1] != g[0]).then_some(g[1]), (g[2] != g[0] && g[2] != g[1]).then_some(g[2])]
    }
}

/// Twice the area times the unit normal.
fn face_normal(positions: &[DVec3], corners: &[u32; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|c| positions[c as usize]);
    (b - a).cross(c - a)
}

/// Normals for `positions` (world space, per vertex). Degenerate places get a zero normal.
pub fn posed_normals(recipe: &NormalRecipe, positions: &[DVec3], triangles: &[[u32; 3]]) -> Normals {
    if recipe.is_flat() {
        return Normals::Flat(triangles.iter().map(|c| face_normal(positions, c).normalize_or_zero()).collect());
    }
    let sums = recipe.group_sums(positions, triangles);
    let normals = (0..positions.len())
        .map(|v| {
            let group = recipe.group[v] as usize;
            let r = sums[group].normalize_or_zero();
            let k = recipe.coordinates[v];
            if k == DVec3::X {
                return r;
            }
            let t = recipe.tangent(positions, group, r);
            r * k.x + t * k.y + r.cross(t) * k.z
        })
        .collect();
    Normals::Smooth(normals)
}

/// Adjoint of [`posed_normals`]: `d_normals` (per vertex or triangle, as [`Normals`]) → ∂L/∂positions, added.
pub fn posed_normals_vjp(
    recipe: &NormalRecipe,
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    d_normals: &[DVec3],
    d_positions: &mut [DVec3],
) {
    if recipe.is_flat() {
        for (corners, &d) in triangles.iter().zip(d_normals) {
            if d != DVec3::ZERO {
                let d_n = normalize_vjp(face_normal(positions, corners), d);
                face_normal_vjp(positions, corners, d_n, d_positions);
            }
        }
        return;
    }
    let sums = recipe.group_sums(positions, triangles);
    let mut d_sums = vec![DVec3::ZERO; recipe.groups];
    for (v, &d) in d_normals.iter().enumerate() {
        if d == DVec3::ZERO {
            continue;
        }
        let group = recipe.group[v] as usize;
        let s = sums[group];
        let k = recipe.coordinates[v];
        if k == DVec3::X {
            d_sums[group] += normalize_vjp(s, d);
            continue;
        }
        let r = s.normalize_or_zero();
        let [a, b] = recipe.edge[group];
        let e = positions[b as usize] - positions[a as usize];
        let flat = e - r * r.dot(e);
        let t = flat.normalize_or_zero();
        // n = k.x r + k.y t + k.z r × t
        let d_t = d * k.y + d.cross(r) * k.z;
        let d_flat = normalize_vjp(flat, d_t);
        let d_r = d * k.x + t.cross(d) * k.z - (d_flat * r.dot(e) + e * r.dot(d_flat));
        let d_e = d_flat - r * r.dot(d_flat);
        d_positions[b as usize] += d_e;
        d_positions[a as usize] -= d_e;
        d_sums[group] += normalize_vjp(s, d_r);
    }
    for corners in triangles {
        let d_n: DVec3 = recipe.groups_of(corners).into_iter().flatten().map(|g| d_sums[g]).sum();
        if d_n != DVec3::ZERO {
            face_normal_vjp(positions, corners, d_n, d_positions);
        }
    }
}

/// Adjoint of v ↦ v/|v| (zero where v is zero).
fn normalize_vjp(v: DVec3, d: DVec3) -> DVec3 {
    let length = v.length();
    if length == 0.0 {
        return DVec3::ZERO;
    }
    let n = v / length;
    (d - n * n.dot(d)) / length
}

fn face_normal_vjp(positions: &[DVec3], corners: &[u32; 3], d: DVec3, d_positions: &mut [DVec3]) {
    let [a, b, c] = corners.map(|c| positions[c as usize]);
    let d_b = (c - a).cross(d);
    let d_c = d.cross(b - a);
    d_positions[corners[1] as usize] += d_b;
    d_positions[corners[2] as usize] += d_c;
    d_positions[corners[0] as usize] -= d_b + d_c;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::blob;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};
    use glam::DQuat;

    fn flatten(n: &Normals) -> &[DVec3] {
        match n {
            Normals::Smooth(n) | Normals::Flat(n) => n,
        }
    }

    fn meshes() -> Vec<(&'static str, Mesh)> {
        let smooth = blob(8, 6);
        let mut flat = smooth.clone();
        flat.normals.clear();
        let mut artistic = smooth.clone();
        let mut rng = SplitMix64(1);
        for n in &mut artistic.normals {
            *n = (*n + DVec3::new(rng.normal(), rng.normal(), rng.normal()) * 0.2).normalize();
        }
        vec![("smooth", smooth), ("flat", flat), ("artistic", artistic)]
    }

    #[test]
    fn the_files_normals_come_back_at_rest_and_turn_with_the_model() {
        for (name, mesh) in meshes().into_iter().filter(|(n, _)| *n != "flat") {
            let recipe = NormalRecipe::new(&mesh);
            let turn = DQuat::from_scaled_axis(DVec3::new(0.4, -0.9, 0.2));
            let turned: Vec<DVec3> = mesh.positions.iter().map(|&p| turn * p + DVec3::X).collect();
            let posed = posed_normals(&recipe, &turned, &mesh.triangles);
            let worst = flatten(&posed)
                .iter()
                .zip(&mesh.normals)
                .enumerate()
                .filter(|(v, _)| mesh.triangles.iter().flatten().any(|t| *t as usize == *v))
                .map(|(_, (a, &b))| (*a - turn * b).length())
                .fold(0.0f64, f64::max);
            println!("{name}: worst difference to the turned file normal {worst:.1e}");
            assert!(worst < 2e-3);
        }
    }

    #[test]
    fn normals_have_an_exact_gradient_for_every_kind_of_shading() {
        for (name, mesh) in meshes() {
            let recipe = NormalRecipe::new(&mesh);
            let mut rng = SplitMix64(2);
            let count = flatten(&posed_normals(&recipe, &mesh.positions, &mesh.triangles)).len();
            let d: Vec<DVec3> = (0..count).map(|_| DVec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
            let mut g = vec![DVec3::ZERO; mesh.positions.len()];
            posed_normals_vjp(&recipe, &mesh.positions, &mesh.triangles, &d, &mut g);
            let x: Vec<f64> = mesh.positions.iter().flat_map(|p| p.to_array()).collect();
            let g: Vec<f64> = g.iter().flat_map(|p| p.to_array()).collect();
            let f = |x: &[f64]| {
                let p: Vec<DVec3> = x.chunks(3).map(DVec3::from_slice).collect();
                flatten(&posed_normals(&recipe, &p, &mesh.triangles)).iter().zip(&d).map(|(n, d)| n.dot(*d)).sum()
            };
            let error = gradient_error(f, &x, &g, 8, &[1e-3, 1e-4, 1e-5, 1e-6], 5);
            println!("{name}: gradient error {error:.1e}");
            assert!(error < 1e-6);
        }
    }
}

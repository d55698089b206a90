//! Where a surface ends on the screen: edges between front and back faces, and open borders.
//!
//! Each is cut with the lines through pixel centres: a crossing says where, between two neighbouring pixel centres, a surface
//! stops, and which point of it that is.

use crate::interpolate::Weights;
use crate::project::ScreenPoint;
use crate::raster::NONE;
use animimic_scene::Mesh;

/// What does not depend on the pose: joined vertices and edges.
#[derive(Clone, Debug, Default)]
pub struct Topology {
    /// Vertex → joined vertex.
    pub joined: Vec<u32>,
    /// Number of joined vertices.
    pub joined_count: usize,
    /// Edges of the joined surface.
    pub edges: Vec<MeshEdge>,
}

/// An edge with the one or two triangles at it. Edges of more triangles are listed once for each of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshEdge {
    /// Vertices, as the first triangle has them.
    pub vertices: [u32; 2],
    /// The first triangle's third vertex.
    pub opposite: u32,
    /// Triangles; the second is [`NONE`] on borders.
    pub triangles: [u32; 2],
}

impl Topology {
    /// Joins vertices by the mesh's weld map and lists the edges.
    pub fn new(mesh: &Mesh) -> Self {
        let n = mesh.positions.len();
        let joined: Vec<u32> = if mesh.welded.len() == n { mesh.welded.clone() } else { (0..n as u32).collect() };
        let joined_count = joined.iter().max().map_or(0, |&m| m as usize + 1);
        // (joined vertices, triangle, side)
        let mut sides: Vec<([u32; 2], u32, usize)> = Vec::with_capacity(3 * mesh.triangles.len());
        for (t, corners) in mesh.triangles.iter().enumerate() {
            for k in 0..3 {
                let [a, b] = [k, (k + 1) % 3].map(|k| joined[corners[k] as usize]);
                sides.push(([a.min(b), a.max(b)], t as u32, k));
            }
        }
        sides.sort_unstable();
        let edge = |&(_, t, k): &([u32; 2], u32, usize), second: u32| {
            let c = mesh.triangles[t as usize];
            MeshEdge { vertices: [c[k], c[(k + 1) % 3]], opposite: c[(k + 2) % 3], triangles: [t, second] }
        };
        let mut edges = Vec::with_capacity(sides.len() / 2 + 1);
        for same in sides.chunk_by(|a, b| a.0 == b.0) {
            match same {
                [a, b] => edges.push(edge(a, b.1)),
                _ => edges.extend(same.iter().map(|a| edge(a, NONE))),
            }
        }
        Self { joined, joined_count, edges }
    }
}

/// A place where a possible silhouette crosses the line between two neighbouring pixel centres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Twice the index of the left or upper pixel, plus 1 where the other is below it.
    pub pair: u32,
    /// Position between the two centres, 0 to 1.
    pub t: f32,
    /// Whether the surface is on the left or upper side.
    pub surface_first: bool,
    /// Edge vertices.
    pub vertices: [u32; 2],
    /// Affine screen weight of the second vertex.
    pub s: f32,
    /// The triangle that is seen of the two at the edge (or the only one).
    pub triangle: u32,
    /// Inverse depth there.
    pub q: f32,
}

/// Which vertices lie on a silhouette, and all crossings, sorted by pair.
#[derive(Clone, Debug, Default)]
pub struct Silhouette {
    /// Per vertex: whether it lies on a possible silhouette.
    pub vertices: Vec<bool>,
    /// Crossings by [`Crossing::pair`].
    pub crossings: Vec<Crossing>,
}

impl Silhouette {
    /// The crossings of one pair of pixels.
    pub fn at(&self, pair: u32) -> &[Crossing] {
        let first = self.crossings.partition_point(|c| c.pair < pair);
        let count = self.crossings[first..].iter().take_while(|c| c.pair == pair).count();
        &self.crossings[first..first + count]
    }
}

/// Finds silhouettes for projected vertices in a picture of `width` × `height` pixels; `cull_back` as in [`crate::raster::Facing`]. Triangles that reach behind the
/// camera count as silhouettes.
pub fn silhouette(
    topology: &Topology,
    triangles: &[[u32; 3]],
    screen: &[ScreenPoint],
    cull_back: &[bool],
    width: usize,
    height: usize,
) -> Silhouette {
    let corners = |t: &[u32; 3]| [screen[t[0] as usize], screen[t[1] as usize], screen[t[2] as usize]];
    let mut behind = Vec::new();
    let front: Vec<bool> = triangles
        .iter()
        .map(|t| {
            let p = corners(t);
            if p.iter().any(|p| p.q <= 0.0) {
                behind.push(*t);
            }
            area(p) < 0.0
        })
        .collect();
    let mut on_silhouette = vec![false; topology.joined_count];
    let mut crossings = Vec::new();
    for edge in &topology.edges {
        let [t, u] = edge.triangles;
        if u != NONE && front[t as usize] == front[u as usize] {
            continue;
        }
        edge.vertices.iter().for_each(|&v| on_silhouette[topology.joined[v as usize] as usize] = true);
        let triangle = if u == NONE { t } else { visible(edge, triangles, screen, &front, cull_back) };
        cross(edge, triangle, screen, width, height, &mut crossings);
    }
    for t in &behind {
        t.iter().for_each(|&v| on_silhouette[topology.joined[v as usize] as usize] = true);
    }
    crossings.sort_by_key(|c| c.pair);
    let vertices = topology.joined.iter().map(|&v| on_silhouette[v as usize]).collect();
    Silhouette { vertices, crossings }
}

/// The one of a fold's two triangles that is seen: the front where backs are hidden, else the nearer.
fn visible(edge: &MeshEdge, triangles: &[[u32; 3]], screen: &[ScreenPoint], front: &[bool], cull_back: &[bool]) -> u32 {
    let [t, u] = edge.triangles;
    if cull_back.get(t as usize).copied().unwrap_or(false) {
        return if front[t as usize] { t } else { u };
    }
    // Both lie on the same side of the edge: compare their planes' inverse depth at the first one's third vertex.
    let at = screen[edge.opposite as usize];
    let other = triangles[u as usize].map(|v| screen[v as usize]);
    let nearer = Weights::new(other).is_some_and(|w| f64::from(w.inverse_depth(at.x as f32, at.y as f32)) > at.q);
    if nearer { u } else { t }
}

fn area(p: [ScreenPoint; 3]) -> f64 {
    (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[2].x - p[0].x) * (p[1].y - p[0].y)
}

/// Cuts one edge with the rows and columns of pixel centres.
fn cross(edge: &MeshEdge, triangle: u32, screen: &[ScreenPoint], width: usize, height: usize, out: &mut Vec<Crossing>) {
    let [a, b] = edge.vertices.map(|v| screen[v as usize]);
    let side = area([a, b, screen[edge.opposite as usize]]);
    if a.q <= 0.0 || b.q <= 0.0 || !side.is_finite() {
        return;
    }
    let mut add = |s: f64, line: usize, along: f64, vertical: bool, second: bool| {
        let length = if vertical { height } else { width };
        let before = (along - 0.5).floor();
        if before < 0.0 || before as usize + 1 >= length {
            return;
        }
        let k = before as usize;
        let pixel = if vertical { k * width + line } else { line * width + k };
        out.push(Crossing {
            pair: 2 * pixel as u32 + u32::from(vertical),
            t: (along - 0.5 - before) as f32,
            surface_first: !second,
            vertices: edge.vertices,
            s: s as f32,
            triangle,
            q: (a.q + s * (b.q - a.q)) as f32,
        });
    };
    // Rows: the surface is to the right where stepping right goes to the opposite vertex's side.
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    for row in centres(a.y, b.y, height) {
        let s = (row as f64 + 0.5 - a.y) / dy;
        add(s, row, a.x + s * dx, false, (-dy > 0.0) == (side > 0.0));
    }
    for column in centres(a.x, b.x, width) {
        let s = (column as f64 + 0.5 - a.x) / dx;
        add(s, column, a.y + s * dy, true, (dx > 0.0) == (side > 0.0));
    }
}

/// Pixel indices whose centres lie between two coordinates.
fn centres(a: f64, b: f64, size: usize) -> std::ops::Range<usize> {
    let first = (a.min(b) - 0.5).ceil().clamp(0.0, size as f64);
    let end = (a.max(b) - 0.5).ceil().clamp(0.0, size as f64);
    first as usize..end as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::blob;
    use crate::project::project;
    use animimic_scene::Camera;
    use glam::DVec3;

    #[test]
    fn a_closed_body_has_silhouettes_in_a_ring_and_an_open_one_at_its_border() {
        let mut mesh = blob(24, 16);
        let camera = Camera::orbit(DVec3::ZERO, 4.0, 0.3, 0.2, 0.7, 64, 64);
        let screen = project(&camera, &mesh.positions);
        let share = |mesh: &Mesh| {
            let found = silhouette(&Topology::new(mesh), &mesh.triangles, &screen, &[], 64, 64);
            found.vertices.iter().filter(|&&f| f).count() as f64 / found.vertices.len() as f64
        };
        let closed = share(&mesh);
        println!("share of vertices on the silhouette of a closed body: {closed:.2}");
        assert!(closed > 0.05 && closed < 0.4);
        let borders = |mesh: &Mesh| Topology::new(mesh).edges.iter().filter(|e| e.triangles[1] == NONE).count();
        assert_eq!(borders(&mesh), 0);
        mesh.triangles.truncate(mesh.triangles.len() - 20);
        assert!(borders(&mesh) >= 20);
    }

    #[test]
    fn every_step_between_surface_and_background_has_a_crossing_with_the_surface_on_the_right_side() {
        let mesh = blob(24, 16);
        let camera = Camera::orbit(DVec3::ZERO, 4.0, 0.3, 0.2, 0.7, 64, 64);
        let screen = project(&camera, &mesh.positions);
        let raster = crate::raster::rasterize(&camera, &mesh.positions, &mesh.triangles);
        let found = silhouette(&Topology::new(&mesh), &mesh.triangles, &screen, &[], 64, 64);
        let (mut steps, mut missing) = (0, 0);
        for pixel in 0..64 * 63 - 1 {
            for (axis, other) in [pixel + 1, pixel + 64].into_iter().enumerate() {
                if raster.covered(pixel) != raster.covered(other) && (axis == 1 || pixel % 64 < 63) {
                    steps += 1;
                    let at = found.at((2 * pixel + axis) as u32);
                    missing += usize::from(!at.iter().any(|c| c.surface_first == raster.covered(pixel)));
                }
            }
        }
        println!("{steps} steps, {missing} without a crossing");
        assert!(steps > 100 && missing == 0);
    }
}

//! Where a surface may end on the screen: vertices between front and back faces, and open borders.
//!
//! Used to tell occlusions from continuous surfaces without asking the picture.

use crate::project::ScreenPoint;
use animimic_scene::Mesh;

/// What does not depend on the pose: joined vertices and those on open borders.
#[derive(Clone, Debug, Default)]
pub struct Topology {
    /// Vertex → joined vertex.
    pub joined: Vec<u32>,
    /// Joined vertices on edges that do not have exactly two triangles.
    pub border: Vec<bool>,
}

impl Topology {
    /// Joins vertices by the mesh's weld map and finds the open borders.
    pub fn new(mesh: &Mesh) -> Self {
        let n = mesh.positions.len();
        let joined: Vec<u32> = if mesh.welded.len() == n { mesh.welded.clone() } else { (0..n as u32).collect() };
        let count = joined.iter().max().map_or(0, |&m| m as usize + 1);
        let mut edges: Vec<[u32; 2]> = mesh
            .triangles
            .iter()
            .flat_map(|t| {
                let j = t.map(|v| joined[v as usize]);
                [[j[0], j[1]], [j[1], j[2]], [j[2], j[0]]].map(|[a, b]| [a.min(b), a.max(b)])
            })
            .collect();
        edges.sort_unstable();
        let mut border = vec![false; count];
        for same in edges.chunk_by(|a, b| a == b) {
            if same.len() != 2 {
                same[0].iter().for_each(|&v| border[v as usize] = true);
            }
        }
        Self { joined, border }
    }
}

/// Per triangle: whether one of its corners lies on a possible silhouette at these screen points. Triangles that reach
/// behind the camera count as possible.
pub fn silhouette_triangles(topology: &Topology, triangles: &[[u32; 3]], screen: &[ScreenPoint]) -> Vec<bool> {
    const FRONT: u8 = 1;
    const BACK: u8 = 2;
    let mut sides: Vec<u8> = topology.border.iter().map(|&b| if b { FRONT | BACK } else { 0 }).collect();
    for t in triangles {
        let p = t.map(|v| screen[v as usize]);
        let area = (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[2].x - p[0].x) * (p[1].y - p[0].y);
        let behind = p.iter().any(|p| p.q <= 0.0);
        let side = if behind {
            FRONT | BACK
        } else if area < 0.0 {
            FRONT
        } else {
            BACK
        };
        t.iter().for_each(|&v| sides[topology.joined[v as usize] as usize] |= side);
    }
    triangles.iter().map(|t| t.iter().any(|&v| sides[topology.joined[v as usize] as usize] == FRONT | BACK)).collect()
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
            let flags = silhouette_triangles(&Topology::new(mesh), &mesh.triangles, &screen);
            flags.iter().filter(|&&f| f).count() as f64 / flags.len() as f64
        };
        let closed = share(&mesh);
        println!("share of triangles at the silhouette of a closed body: {closed:.2}");
        assert!(closed > 0.05 && closed < 0.5);
        assert!(!Topology::new(&mesh).border.contains(&true));
        mesh.triangles.truncate(mesh.triangles.len() - 20);
        assert!(Topology::new(&mesh).border.contains(&true));
    }
}

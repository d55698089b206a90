//! Volume change: how much the enclosed volume departs from rest.
//!
//! V = ⅙ Σ (a × b)·c over faces (divergence theorem), holes closed by a fan from each boundary loop to its centroid,
//! so that the figure does not depend on the origin.

use super::{Evidence, Metric, Missing, Reading};
use animimic_scene::Mesh;
use glam::DVec3;

pub struct VolumeChange;

impl Metric for VolumeChange {
    fn name(&self) -> &'static str {
        "volume change"
    }

    fn definition(&self) -> &'static str {
        "max over frames of |V(t)/V(0) − 1| of the volume enclosed by the surface, holes closed by fans"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let mesh = &e.asset.mesh;
        let holes = boundary_loops(mesh);
        let volume = |p: &[DVec3]| enclosed(mesh, &holes, p);
        let first = e.frames.first().map_or(0.0, |f| volume(f));
        // Sheets enclose next to nothing and would divide by it.
        const THINNEST: f64 = 1e-6;
        if first.abs() < THINNEST * super::diagonal(&mesh.positions).powi(3) {
            return Err(Missing("the surface encloses no volume"));
        }
        let change = e.frames.iter().map(|f| (volume(f) / first - 1.0).abs()).fold(0.0, f64::max);
        Ok(vec![("volume_change_max".into(), change)])
    }
}

/// Volume enclosed by the surface at some positions, holes closed [model unit³].
pub fn enclosed_volume(mesh: &Mesh, positions: &[DVec3]) -> f64 {
    enclosed(mesh, &boundary_loops(mesh), positions)
}

fn enclosed(mesh: &Mesh, holes: &[Vec<[u32; 2]>], x: &[DVec3]) -> f64 {
    let tet = |a: DVec3, b: DVec3, c: DVec3| a.cross(b).dot(c) / 6.0;
    let faces: f64 = mesh.triangles.iter().map(|t| tet(x[t[0] as usize], x[t[1] as usize], x[t[2] as usize])).sum();
    let fans: f64 = holes
        .iter()
        .map(|edges| {
            let center = edges.iter().map(|e| x[e[0] as usize]).sum::<DVec3>() / edges.len() as f64;
            edges.iter().map(|e| tet(x[e[1] as usize], x[e[0] as usize], center)).sum::<f64>()
        })
        .sum();
    faces + fans
}

/// Directed edges (as vertex indices) without their opposite, grouped by connected loop.
fn boundary_loops(mesh: &Mesh) -> Vec<Vec<[u32; 2]>> {
    let weld = |i: u32| mesh.welded[i as usize];
    let mut edges: Vec<([u32; 2], i32, [u32; 2])> = Vec::with_capacity(3 * mesh.triangles.len());
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            let (wa, wb) = (weld(a), weld(b));
            if wa != wb {
                edges.push(([wa.min(wb), wa.max(wb)], if wa < wb { 1 } else { -1 }, [a, b]));
            }
        }
    }
    edges.sort_unstable();
    let mut open: Vec<[u32; 2]> = Vec::new();
    for group in edges.chunk_by(|a, b| a.0 == b.0) {
        let surplus: i32 = group.iter().map(|e| e.1).sum();
        open.extend(
            group.iter().filter(|e| e.1 == surplus.signum()).take(surplus.unsigned_abs() as usize).map(|e| e.2),
        );
    }
    let mut root: Vec<u32> = (0..mesh.welded_count as u32).collect();
    fn find(root: &mut [u32], mut i: u32) -> u32 {
        while root[i as usize] != i {
            root[i as usize] = root[root[i as usize] as usize];
            i = root[i as usize];
        }
        i
    }
    for e in &open {
        let (a, b) = (find(&mut root, weld(e[0])), find(&mut root, weld(e[1])));
        root[a.max(b) as usize] = a.min(b);
    }
    let mut keyed: Vec<(u32, [u32; 2])> = open.iter().map(|e| (find(&mut root, weld(e[0])), *e)).collect();
    keyed.sort_unstable();
    keyed.chunk_by(|a, b| a.0 == b.0).map(|g| g.iter().map(|e| e.1).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::fixtures;
    use super::*;

    #[test]
    fn the_octahedron_has_four_thirds_also_far_from_the_origin_and_with_a_face_missing() {
        let mut mesh = fixtures::octahedron();
        let v = enclosed_volume(&mesh, &mesh.positions);
        assert!((v - 4.0 / 3.0).abs() < 1e-12, "{v}");
        mesh.triangles.pop();
        let far: Vec<DVec3> = mesh.positions.iter().map(|p| *p + DVec3::splat(100.0)).collect();
        let v = enclosed_volume(&mesh, &far);
        println!("{v}");
        assert!((v - 4.0 / 3.0).abs() < 1e-8, "{v}");
    }

    #[test]
    fn stretching_by_a_tenth_changes_the_volume_by_a_tenth() {
        let (asset, mut frames) = fixtures::sliding(0.0, 3);
        frames[2].iter_mut().for_each(|p| p.y *= 1.1);
        let c = VolumeChange.measure(&fixtures::evidence(&asset, &frames)).unwrap()[0].1;
        println!("{c}");
        assert!((c - 0.1).abs() < 1e-12);
    }
}

//! How good a tet mesh is, and how it hangs together.

use animimic_scene::TetMesh;
use animimic_scene::solid::UnionFind;
use glam::DVec3;

/// Figures of a tet mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quality {
    /// Least and largest dihedral angle [°].
    pub dihedral_deg: [f64; 2],
    /// Least and mean ratio of the inscribed sphere's radius to the circumscribed one's, times 3: 1 for the regular tet.
    pub radius_ratio: [f64; 2],
    /// Tets that are flat or inside out.
    pub inverted: usize,
    /// Euler number of the complex: vertices − edges + faces − tets. Half that of its boundary, where that is a manifold.
    pub euler: i64,
    /// Parts that share no vertex.
    pub components: usize,
}

/// Measures a mesh.
pub fn quality(mesh: &TetMesh) -> Quality {
    let mut out = Quality { dihedral_deg: [180.0, 0.0], radius_ratio: [1.0, 0.0], ..Quality::default() };
    let (mut edges, mut faces) = (Vec::with_capacity(6 * mesh.tets.len()), Vec::with_capacity(4 * mesh.tets.len()));
    let mut parts = UnionFind::new(mesh.positions.len());
    for tet in &mesh.tets {
        let x = tet.map(|v| mesh.positions[v as usize]);
        let mut sorted = *tet;
        sorted.sort_unstable();
        for i in 0..4 {
            parts.join(tet[0] as usize, tet[i] as usize);
            let mut face = sorted.to_vec();
            face.remove(i);
            faces.push([face[0], face[1], face[2]]);
            for j in i + 1..4 {
                edges.push([sorted[i], sorted[j]]);
                let angle = dihedral_deg(&x, i, j);
                out.dihedral_deg = [out.dihedral_deg[0].min(angle), out.dihedral_deg[1].max(angle)];
            }
        }
        let ratio = radius_ratio(&x);
        out.inverted += usize::from(ratio <= 0.0 || ratio.is_nan());
        out.radius_ratio[0] = out.radius_ratio[0].min(ratio);
        out.radius_ratio[1] += ratio / mesh.tets.len() as f64;
    }
    edges.sort_unstable();
    edges.dedup();
    faces.sort_unstable();
    faces.dedup();
    out.euler = mesh.positions.len() as i64 - edges.len() as i64 + faces.len() as i64 - mesh.tets.len() as i64;
    out.components = (0..mesh.positions.len()).filter(|&v| parts.find(v) == v).count();
    out
}

/// Angle between the faces at the edge that vertices `i` and `j` do *not* have [°].
fn dihedral_deg(x: &[DVec3; 4], i: usize, j: usize) -> f64 {
    let rest: Vec<usize> = (0..4).filter(|&k| k != i && k != j).collect();
    let (a, b) = (x[rest[0]], x[rest[1]]);
    let axis = (b - a).normalize_or_zero();
    let across = |p: DVec3| {
        let d = p - a;
        (d - axis * axis.dot(d)).normalize_or_zero()
    };
    across(x[i]).dot(across(x[j])).clamp(-1.0, 1.0).acos().to_degrees()
}

/// 3 r/R, negative for tets inside out.
fn radius_ratio(x: &[DVec3; 4]) -> f64 {
    let [a, b, c] = [x[1] - x[0], x[2] - x[0], x[3] - x[0]];
    let six_volumes = a.cross(b).dot(c);
    let areas = 0.5 * (a.cross(b).length() + b.cross(c).length() + c.cross(a).length() + (b - a).cross(c - a).length());
    let inner = 0.5 * six_volumes / areas;
    let circum = a.length_squared() * b.cross(c) + b.length_squared() * c.cross(a) + c.length_squared() * a.cross(b);
    let outer = circum.length() / (2.0 * six_volumes.abs());
    3.0 * inner / outer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_regular_tet_is_best_and_a_ring_of_cubes_has_a_hole() {
        let s = [[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]].map(DVec3::from_array);
        let mesh = TetMesh { positions: s.to_vec(), tets: vec![[0, 1, 2, 3]] };
        let q = quality(&mesh);
        println!("{q:?}");
        assert!((q.radius_ratio[0].abs() - 1.0).abs() < 1e-12 && (q.dihedral_deg[0] - 70.528_779).abs() < 1e-5);
        assert_eq!((q.euler, q.components), (1, 1));
        let beam = crate::fixtures::beam([3, 1, 1], [3.0, 1.0, 1.0]);
        assert_eq!((quality(&beam).euler, quality(&beam).inverted), (1, 0));
    }
}

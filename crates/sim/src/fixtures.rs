//! Meshes made by code, for tests, examples and benches.

use animimic_scene::TetMesh;
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// A box of `size` [m] with one corner at the origin, cut into `cells` cells of six tets each (Kuhn 1960); vertices are
/// numbered x-major, z fastest.
pub fn beam(cells: [usize; 3], size: [f64; 3]) -> TetMesh {
    let [nx, ny, nz] = cells;
    let id = |c: [usize; 3]| ((c[0] * (ny + 1) + c[1]) * (nz + 1) + c[2]) as u32;
    let mut mesh = TetMesh::default();
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                let at = |n: usize, cells: usize, size: f64| size * n as f64 / cells as f64;
                mesh.positions.push(DVec3::new(at(i, nx, size[0]), at(j, ny, size[1]), at(k, nz, size[2])));
            }
        }
    }
    const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    for cell in (0..nx * ny * nz).map(|c| [c / (ny * nz), c / nz % ny, c % nz]) {
        for (n, path) in PATHS.iter().enumerate() {
            let mut corner = cell;
            let mut tet = [id(cell); 4];
            for (t, &axis) in tet[1..].iter_mut().zip(path) {
                corner[axis] += 1;
                *t = id(corner);
            }
            // Odd permutations give negative volume.
            if matches!(n, 1 | 2 | 5) {
                tet.swap(1, 2);
            }
            mesh.tets.push(tet);
        }
    }
    mesh
}

/// A square column of `cells` cubes of edge `width` [m] along x from the origin, its axis in the middle of y, z ∈ \[0, width\].
///
/// Every cube is cut into 24 tets around its centre, so that the mesh has all the symmetries of the column: squeezed
/// straight it is exactly on the saddle from which it would buckle. Returns also the vertices of the two end faces.
pub fn column(cells: usize, width: f64) -> (TetMesh, Vec<u32>) {
    let mut mesh = TetMesh::default();
    // Points in half cells; every point with a fixed number of odd coordinates is a corner, face centre or cell centre.
    let mut number = BTreeMap::new();
    for p in (0..=2 * cells).flat_map(|i| (0..9).map(move |n| [i, n / 3, n % 3])) {
        if p.iter().filter(|c| *c % 2 == 1).count() != 1 {
            number.insert(p, mesh.positions.len() as u32);
            mesh.positions.push(0.5 * width * DVec3::new(p[0] as f64, p[1] as f64, p[2] as f64));
        }
    }
    for cell in 0..cells {
        let centre = [2 * cell + 1, 1, 1];
        for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 2)]) {
            let at = |offsets: [usize; 2]| {
                let mut p = centre;
                p[axis] = p[axis] + side - 1;
                p[(axis + 1) % 3] = p[(axis + 1) % 3] + offsets[0] - 1;
                p[(axis + 2) % 3] = p[(axis + 2) % 3] + offsets[1] - 1;
                number[&p]
            };
            let around = [[0, 0], [2, 0], [2, 2], [0, 2]];
            for n in 0..4 {
                let (a, b) = (at(around[n]), at(around[(n + 1) % 4]));
                let (a, b) = if side == 2 { (a, b) } else { (b, a) };
                mesh.tets.push([number[&centre], at([1, 1]), a, b]);
            }
        }
    }
    let end = cells as f64 * width;
    let at_end = |v: &u32| [0.0, end].contains(&mesh.positions[*v as usize].x);
    let ends = (0..mesh.positions.len() as u32).filter(at_end).collect();
    (mesh, ends)
}

/// A simulation problem: mesh, moduli, driven vertices and their path.
#[derive(Clone, Debug)]
pub struct Problem {
    /// The mesh.
    pub mesh: TetMesh,
    /// Young's modulus [Pa], per tet.
    pub youngs: Vec<f64>,
    /// Driven vertices.
    pub driven: Vec<u32>,
    /// Their positions [m], \[step\]\[driven\].
    pub path: Vec<Vec<DVec3>>,
}

/// Poisson's ratio of [`driven_beam`].
pub const BEAM_POISSON: f64 = 0.4;
/// Density of [`driven_beam`] [kg/m³].
pub const BEAM_DENSITY: f64 = 1000.0;

/// The project's benchmark: a 2 × 0.5 × 0.5 m beam of uneven stiffness around `e0` Pa whose root block shakes and turns and
/// whose inner bone swings; `h` is the step in seconds.
pub fn driven_beam(cells: [usize; 3], e0: f64, h: f64, steps: usize) -> Problem {
    const LENGTH: f64 = 2.0;
    const WIDTH: f64 = 0.5;
    let mesh = beam(cells, [LENGTH, WIDTH, WIDTH]);
    let centroid = |t: &[u32; 4]| t.iter().map(|&v| mesh.positions[v as usize]).sum::<DVec3>() / 4.0;
    let youngs = |c: DVec3| e0 * (0.8 * (3.0 * c.x).sin() * (7.0 * c.y).cos()).exp();
    let youngs = mesh.tets.iter().map(|t| youngs(centroid(t))).collect();
    let in_bone = |p: DVec3| {
        let centred = |v: f64| (v - WIDTH / 2.0).abs() <= 0.26 * WIDTH;
        (p.x - 0.55 * LENGTH).abs() <= 0.07 * LENGTH && centred(p.y) && centred(p.z)
    };
    let in_root = |p: DVec3| p.x <= 0.1 * LENGTH + 1e-9;
    let all = 0..mesh.positions.len() as u32;
    let driven: Vec<u32> =
        all.filter(|&v| in_root(mesh.positions[v as usize]) || in_bone(mesh.positions[v as usize])).collect();
    let place = |p: DVec3, t: f64| {
        let u = (t / 0.25).min(1.0);
        let s = u * u * (3.0 - 2.0 * u);
        let wave = |hertz: f64| (std::f64::consts::TAU * hertz * t).sin();
        let root_pivot = DVec3::new(0.0, WIDTH / 2.0, WIDTH / 2.0);
        let bone_pivot = DVec3::new(0.1 * LENGTH, WIDTH / 2.0, WIDTH / 2.0);
        let root = DMat3::from_rotation_y(s * 20f64.to_radians() * wave(1.0));
        let bone = DMat3::from_rotation_z(s * 25f64.to_radians() * wave(1.25));
        let p = if in_bone(p) { bone * (p - bone_pivot) + bone_pivot } else { p };
        root * (p - root_pivot) + root_pivot + DVec3::new(0.0, 0.0, s * 0.15 * wave(1.5))
    };
    let frame = |n: usize| driven.iter().map(|&v| place(mesh.positions[v as usize], (n + 1) as f64 * h)).collect();
    let path = (0..steps).map(frame).collect();
    Problem { youngs, driven, path, mesh }
}

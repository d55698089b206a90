//! Surfaces for tests, all made here.

use animimic_scene::io::weld;
use animimic_scene::{Asset, Mesh};
use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// Adds a closed ellipsoid.
fn add_ellipsoid(mesh: &mut Mesh, center: DVec3, radii: DVec3) {
    let (around, down) = (16u32, 12u32);
    let first = mesh.positions.len() as u32;
    for j in 0..=down {
        for i in 0..around {
            let (a, b) = (TAU * f64::from(i) / f64::from(around), PI * f64::from(j) / f64::from(down));
            let sine = if j % down == 0 { 0.0 } else { b.sin() };
            mesh.positions.push(center + radii * DVec3::new(sine * a.cos(), b.cos(), sine * a.sin()));
        }
    }
    let at = |j: u32, i: u32| first + j * around + i % around;
    for j in 0..down {
        for i in 0..around {
            mesh.triangles.push([at(j, i), at(j, i + 1), at(j + 1, i + 1)]);
            mesh.triangles.push([at(j, i), at(j + 1, i + 1), at(j + 1, i)]);
        }
    }
}

fn asset(mut mesh: Mesh) -> Asset {
    (mesh.welded, mesh.welded_count) = weld::by_position(&mesh.positions);
    Asset { mesh, ..Asset::default() }
}

/// A creature of closed pieces that overlap, symmetric in x: body along z, head in front, tail, four legs with a gap between them.
pub fn quadruped() -> Asset {
    let mut mesh = Mesh::default();
    let mut add = |c: [f64; 3], r: [f64; 3]| add_ellipsoid(&mut mesh, c.into(), r.into());
    add([0.0, 1.0, 0.0], [0.24, 0.26, 0.8]);
    add([0.0, 1.25, 0.95], [0.13, 0.13, 0.36]);
    add([0.0, 1.15, -1.0], [0.07, 0.07, 0.5]);
    for x in [-0.14, 0.14] {
        add([x, 0.5, 0.5], [0.09, 0.55, 0.1]);
        add([x, 0.5, -0.5], [0.09, 0.55, 0.1]);
    }
    asset(mesh)
}

/// The same creature in mid-stride: the legs of each row swing apart.
pub fn walking() -> Asset {
    let mut asset = quadruped();
    for p in asset.mesh.positions.iter_mut().skip(3 * 16 * 13) {
        let stride = p.x.signum() * if p.z > 0.0 { 0.35 } else { 0.2 };
        let hip = DVec3::new(0.0, 1.0, 0.5 * p.z.signum());
        *p = hip + glam::DQuat::from_rotation_x(stride) * (*p - hip);
    }
    asset
}

/// Two legs side by side under a bar, with a gap far narrower than a voxel.
pub fn trousers() -> Asset {
    let mut mesh = Mesh::default();
    add_ellipsoid(&mut mesh, DVec3::new(0.0, 1.1, 0.0), DVec3::new(0.3, 0.25, 0.16));
    for side in [-1.0, 1.0] {
        add_ellipsoid(&mut mesh, DVec3::new(side * 0.1005, 0.5, 0.0), DVec3::new(0.1, 0.55, 0.1));
    }
    asset(mesh)
}

/// Triangles strewn about, none touching another.
pub fn soup() -> Asset {
    let mut mesh = Mesh::default();
    for k in 0..60u32 {
        let f = |m: f64| (f64::from(k) * m).fract();
        let p = DVec3::new(f(0.618), f(0.414), f(0.732));
        let first = mesh.positions.len() as u32;
        mesh.positions.extend([p, p + DVec3::new(0.1, 0.02, 0.0), p + DVec3::new(0.0, 0.1, 0.05)]);
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    asset(mesh)
}

/// One flat triangle.
pub fn triangle() -> Asset {
    let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    asset(Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() })
}

//! Surfaces for tests, all made here.

use crate::Mesh;
use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// A closed ball with poles.
pub fn sphere(center: DVec3, radius: f64, around: usize, down: usize) -> Mesh {
    let mut mesh = Mesh::default();
    mesh.positions.push(center + DVec3::Y * radius);
    for j in 1..down {
        for i in 0..around {
            let (a, b) = (TAU * i as f64 / around as f64, PI * j as f64 / down as f64);
            mesh.positions.push(center + radius * DVec3::new(b.sin() * a.cos(), b.cos(), b.sin() * a.sin()));
        }
    }
    mesh.positions.push(center - DVec3::Y * radius);
    let at = |j: usize, i: usize| (1 + (j - 1) * around + i % around) as u32;
    let last = mesh.positions.len() as u32 - 1;
    for i in 0..around {
        mesh.triangles.push([0, at(1, i + 1), at(1, i)]);
        mesh.triangles.push([last, at(down - 1, i), at(down - 1, i + 1)]);
        for j in 1..down - 1 {
            mesh.triangles.push([at(j, i), at(j, i + 1), at(j + 1, i + 1)]);
            mesh.triangles.push([at(j, i), at(j + 1, i + 1), at(j + 1, i)]);
        }
    }
    mesh
}

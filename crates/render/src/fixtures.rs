//! Small models made by code, for tests.

use animimic_scene::{Image, Look, Mesh, Part, Texture};
use glam::{DVec2, DVec3};

/// A bumpy sphere of radius about 1 with a UV seam: `around` × `along` quads, smooth normals, one part.
pub fn blob(around: usize, along: usize) -> Mesh {
    let mut mesh = Mesh::default();
    for j in 0..=along {
        for i in 0..=around {
            let (u, v) = (i as f64 / around as f64, j as f64 / along as f64);
            let (theta, phi) = (std::f64::consts::TAU * (i % around) as f64 / around as f64, std::f64::consts::PI * v);
            let d = DVec3::new(phi.sin() * theta.cos(), phi.cos(), phi.sin() * theta.sin());
            let d = if j == 0 {
                DVec3::Y
            } else if j == along {
                -DVec3::Y
            } else {
                d
            };
            mesh.positions.push(d * (1.0 + 0.15 * (3.0 * d.x).sin() + 0.1 * (4.0 * d.y).cos()));
            mesh.uvs.push(DVec2::new(u, v));
        }
    }
    let at = |i: usize, j: usize| (j * (around + 1) + i) as u32;
    for j in 0..along {
        for i in 0..around {
            if j > 0 {
                mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            }
            if j + 1 < along {
                mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    weld(&mut mesh);
    let mut normals = vec![DVec3::ZERO; mesh.welded_count];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        let mut seen = [u32::MAX; 3];
        for (k, w) in t.map(|v| mesh.welded[v as usize]).into_iter().enumerate() {
            if !seen.contains(&w) {
                normals[w as usize] += (b - a).cross(c - a);
            }
            seen[k] = w;
        }
    }
    mesh.normals = mesh.welded.iter().map(|&w| normals[w as usize].normalize()).collect();
    let part = Part {
        name: "blob".into(),
        vertices: 0..mesh.positions.len(),
        triangles: 0..mesh.triangles.len(),
        look: 0,
        skin: None,
    };
    mesh.parts = vec![part];
    mesh
}

fn weld(mesh: &mut Mesh) {
    let mut points: Vec<DVec3> = Vec::new();
    mesh.welded = mesh
        .positions
        .iter()
        .map(|p| match points.iter().position(|q| q == p) {
            Some(k) => k as u32,
            None => {
                points.push(*p);
                points.len() as u32 - 1
            }
        })
        .collect();
    mesh.welded_count = points.len();
}

/// A look with a smooth, colourful texture of `size`² texels.
pub fn painted(size: usize) -> Look {
    let mut image = Image::filled(size, size, [0; 3]);
    for y in 0..size {
        for x in 0..size {
            let (u, v) = (x as f64 / size as f64 * std::f64::consts::TAU, y as f64 / size as f64 * 9.0);
            let c = [0.5 + 0.4 * (3.0 * u).sin(), 0.5 + 0.4 * v.cos(), 0.5 + 0.4 * (u + v).sin()];
            image.rgb[y * size + x] = c.map(|c: f64| (255.0 * c) as u8);
        }
    }
    Look {
        texture: Some(Texture { image, alpha: Vec::new(), repeat: [true, true], nearest: false }),
        ..Look::default()
    }
}

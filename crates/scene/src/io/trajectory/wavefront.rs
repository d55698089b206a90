//! OBJ of one frame: vertices in the order of the mesh, texture coordinates, a group and a material name per part.

use crate::Asset;
use crate::io::{SceneError, write_atomically};
use glam::DVec3;
use std::io::Write;
use std::path::Path;

/// Writes the mesh with its vertices at `positions`, whole or not at all.
///
/// # Errors
/// [`SceneError::Io`]; [`SceneError::Caller`] for positions of another mesh.
pub fn write(path: impl AsRef<Path>, asset: &Asset, positions: &[DVec3]) -> Result<(), SceneError> {
    let mesh = &asset.mesh;
    if positions.len() != mesh.positions.len() {
        let (found, wanted) = (positions.len(), mesh.positions.len());
        return Err(SceneError::Caller(format!("{found} positions for a mesh of {wanted} vertices")));
    }
    let textured = mesh.uvs.len() == positions.len();
    write_atomically(path, |out| {
        for p in positions {
            let p = p.as_vec3();
            writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
        }
        for t in mesh.uvs.iter().filter(|_| textured) {
            // OBJ counts v from the bottom.
            writeln!(out, "vt {} {}", t.x as f32, (1.0 - t.y) as f32)?;
        }
        for part in &mesh.parts {
            writeln!(out, "g {}", word(&part.name))?;
            if let Some(look) = asset.looks.get(part.look) {
                writeln!(out, "usemtl {}", word(&look.name))?;
            }
            for t in &mesh.triangles[part.triangles.clone()] {
                let [a, b, c] = t.map(|i| i + 1);
                if textured {
                    writeln!(out, "f {a}/{a} {b}/{b} {c}/{c}")?;
                } else {
                    writeln!(out, "f {a} {b} {c}")?;
                }
            }
        }
        Ok(())
    })
}

/// A name without white space, which would end it.
fn word(name: &str) -> String {
    let safe: String = name.chars().map(|c| if c.is_whitespace() { '_' } else { c }).collect();
    if safe.is_empty() { "part".into() } else { safe }
}

//! Gmsh's MSH 2.2 as text, the version that every reader knows (Gmsh manual, "MSH file format version 2").

use super::TetFormat;
use crate::io::SceneError;
use crate::{Embedding, TetMesh};
use std::fmt::Write;

/// Gmsh's own.
pub(super) struct Msh;

impl TetFormat for Msh {
    fn extension(&self) -> &'static str {
        "msh"
    }

    fn bytes(&self, mesh: &TetMesh, _: &Embedding) -> Result<Vec<u8>, SceneError> {
        let mut text = format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{}\n", mesh.positions.len());
        for (k, p) in mesh.positions.iter().enumerate() {
            let _ = writeln!(text, "{} {} {} {}", k + 1, p.x, p.y, p.z);
        }
        let _ = write!(text, "$EndNodes\n$Elements\n{}\n", mesh.tets.len());
        for (k, t) in mesh.tets.iter().enumerate() {
            // Number, kind 4 (tetrahedron), two tags (physical, elementary), vertices from 1.
            let [a, b, c, d] = t.map(|v| v + 1);
            let _ = writeln!(text, "{} 4 2 1 1 {a} {b} {c} {d}", k + 1);
        }
        text += "$EndElements\n";
        Ok(text.into_bytes())
    }
}

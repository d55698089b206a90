//! VTK's XML unstructured grid, as text (VTK User's Guide, "XML File Formats").

use super::TetFormat;
use crate::io::SceneError;
use crate::{Embedding, TetMesh};
use std::fmt::Write;

/// VTK's number of the tetrahedron.
const TETRA: &str = "10";

/// ParaView's own.
pub(super) struct Vtu;

impl TetFormat for Vtu {
    fn extension(&self) -> &'static str {
        "vtu"
    }

    fn bytes(&self, mesh: &TetMesh, _: &Embedding) -> Result<Vec<u8>, SceneError> {
        let mut points = String::new();
        for p in &mesh.positions {
            let _ = writeln!(points, "{} {} {}", p.x, p.y, p.z);
        }
        let (mut tets, mut ends, mut kinds) = (String::new(), String::new(), String::new());
        for (k, [a, b, c, d]) in mesh.tets.iter().enumerate() {
            let _ = writeln!(tets, "{a} {b} {c} {d}");
            let _ = write!(ends, "{} ", 4 * (k + 1));
            kinds += TETRA;
            kinds.push(' ');
        }
        let text = format!(
            "<?xml version=\"1.0\"?>\n\
             <VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
             <UnstructuredGrid>\n<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n\
             <Points>\n<DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">\n{points}</DataArray>\n</Points>\n\
             <Cells>\n<DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">\n{tets}</DataArray>\n\
             <DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">\n{ends}\n</DataArray>\n\
             <DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">\n{kinds}\n</DataArray>\n</Cells>\n\
             </Piece>\n</UnstructuredGrid>\n</VTKFile>\n",
            mesh.positions.len(),
            mesh.tets.len(),
        );
        Ok(text.into_bytes())
    }
}

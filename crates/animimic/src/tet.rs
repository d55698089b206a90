//! A tetrahedral cage of a model file, for simulation here or elsewhere.

use crate::error::Error;
use animimic_scene::io;
use animimic_sim::tet::{Quality, cage, quality};
use std::path::Path;

/// What was made.
#[derive(Clone, Debug)]
pub struct TetReport {
    /// Tets.
    pub tets: usize,
    /// Vertices.
    pub vertices: usize,
    /// Side of the lattice's cubes, the longest edge of a tet [model unit].
    pub spacing: f64,
    /// How good the tets are and how they hang together.
    pub quality: Quality,
    /// What was odd about the model.
    pub warnings: Vec<String>,
}

impl TetReport {
    /// A flat JSON object.
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::json!({
            "tets": self.tets,
            "vertices": self.vertices,
            "spacing": self.spacing,
            "least_dihedral_deg": self.quality.dihedral_deg[0],
            "least_radius_ratio": self.quality.radius_ratio[0],
            "mean_radius_ratio": self.quality.radius_ratio[1],
            "inverted": self.quality.inverted,
            "components": self.quality.components,
            "euler": self.quality.euler,
            "warnings": self.warnings,
        })
    }
}

/// Reads a model (mended if `repair`) and writes a cage of about `tets` tets around it as `out` (`.vtu`, `.msh` or `.npz`).
///
/// # Errors
/// Files that cannot be read or written; a model without a surface; a file name of no such format.
pub fn tet_files(model: &Path, out: &Path, tets: usize, repair: bool) -> Result<TetReport, Error> {
    // Asked first: a wrong name is not found out after the work.
    io::tets::format(out)?;
    let asset = io::read_with(model, &io::ReadOptions { repair })?;
    let cage = cage(&asset.mesh, tets)?;
    io::tets::write(out, &cage.mesh, &cage.embedding)?;
    Ok(TetReport {
        tets: cage.mesh.tets.len(),
        vertices: cage.mesh.positions.len(),
        spacing: cage.spacing,
        quality: quality(&cage.mesh),
        warnings: asset.warnings,
    })
}

//! Tetrahedral meshes and the surface embedded in them.

use glam::DVec3;

/// A tetrahedral mesh in its rest shape.
#[derive(Clone, Debug, Default)]
pub struct TetMesh {
    /// Rest positions [m], per vertex.
    pub positions: Vec<DVec3>,
    /// Vertex indices per tet, positively oriented: det(x1−x0, x2−x0, x3−x0) > 0.
    pub tets: Vec<[u32; 4]>,
}

/// Surface points inside (or near) tets.
#[derive(Clone, Debug, Default)]
pub struct Embedding {
    /// Tet \[surface vertex\].
    pub tet: Vec<u32>,
    /// Barycentric coordinates \[surface vertex\], summing to 1.
    pub barycentric: Vec<[f64; 4]>,
}

//! Triangle meshes as they are drawn, with a weld map that joins what seams split.

use crate::Image;
use glam::{DVec2, DVec3};

/// A triangle mesh: the parts of the source file, concatenated in the order (node, primitive).
///
/// `positions` are in *displayed world space at rest*: what a viewer shows when it opens the file (node transforms and
/// skin applied). Vertices are the file's own, split at seams; [`Mesh::welded`] joins those that seams split.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Rest positions in displayed world space [model unit], per vertex.
    pub positions: Vec<DVec3>,
    /// Unit normals per vertex, or empty where the file has none.
    pub normals: Vec<DVec3>,
    /// Texture coordinates of the base colour texture, glTF convention (origin top left), per vertex; empty if none.
    pub uvs: Vec<DVec2>,
    /// Vertex colours (linear RGB in \[0, 1\]), per vertex; empty if none.
    pub colors: Vec<[f32; 3]>,
    /// Young's modulus of the flesh at the surface [Pa] (glTF's own attribute `_YOUNG`), per vertex; 0 where unknown, empty if none.
    pub youngs: Vec<f32>,
    /// Vertex indices per triangle.
    pub triangles: Vec<[u32; 3]>,
    /// The file's primitives: contiguous ranges of `positions` and `triangles`.
    pub parts: Vec<Part>,
    /// Vertex → welded vertex (equal stored position and, in a rigged file, equal influences), `0..welded_count`.
    pub welded: Vec<u32>,
    /// Number of distinct positions.
    pub welded_count: usize,
}

/// One primitive of the source file inside a [`Mesh`].
#[derive(Clone, Debug, Default)]
pub struct Part {
    /// Name of the node or group it came from.
    pub name: String,
    /// First vertex and number of vertices.
    pub vertices: std::ops::Range<usize>,
    /// First triangle and number of triangles.
    pub triangles: std::ops::Range<usize>,
    /// Index into [`crate::Asset::looks`].
    pub look: usize,
    /// The file's skin that moves it: parts of one skin are stored in one space. `None` for rigid parts and for rigs that are made.
    pub skin: Option<usize>,
}

/// How a surface looks (glTF's material, mechanics' homonym avoided).
#[derive(Clone, Debug)]
pub struct Look {
    /// Name in the file.
    pub name: String,
    /// Linear RGBA factor.
    pub base_color: [f32; 4],
    /// Base colour texture, sRGB-encoded.
    pub texture: Option<Texture>,
    /// Emitted light, linear RGB.
    pub emissive: [f32; 3],
    /// Metallic factor, in \[0, 1\].
    pub metallic: f32,
    /// Roughness factor, in \[0, 1\].
    pub roughness: f32,
    /// How alpha is used.
    pub alpha: AlphaMode,
    /// Drawn from both sides.
    pub double_sided: bool,
    /// Drawn without light (KHR_materials_unlit).
    pub unlit: bool,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [1.0; 4],
            texture: None,
            emissive: [0.0; 3],
            metallic: 0.0,
            roughness: 1.0,
            alpha: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
        }
    }
}

/// glTF's alpha modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    Opaque,
    /// Drawn where alpha is at least the cutoff.
    Mask(f32),
    /// Blended over what is behind.
    Blend,
}

/// A decoded texture with its wrapping.
#[derive(Clone, Debug)]
pub struct Texture {
    /// sRGB-encoded texels, row 0 at v = 0.
    pub image: Image,
    /// Alpha per texel (0–255), or empty when opaque.
    pub alpha: Vec<u8>,
    /// Repeat (true) or clamp (false) along u and v.
    pub repeat: [bool; 2],
    /// Nearest-texel lookup (true) or bilinear (false) when magnified.
    pub nearest: bool,
}

impl Mesh {
    /// Smallest and largest corner of the rest positions; both zero for an empty mesh.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        bounds(&self.positions)
    }

    /// Length of the rest bounding box diagonal [model unit].
    pub fn diagonal(&self) -> f64 {
        let (lo, hi) = self.bounds();
        (hi - lo).length()
    }
}

/// Smallest and largest corner of some points; both zero when there are none.
pub fn bounds(points: &[DVec3]) -> (DVec3, DVec3) {
    let Some(&first) = points.first() else { return (DVec3::ZERO, DVec3::ZERO) };
    points.iter().fold((first, first), |(lo, hi), &p| (lo.min(p), hi.max(p)))
}

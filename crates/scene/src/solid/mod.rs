//! What a mesh encloses: the triangles of any surface put right, and its generalised winding number.
//!
//! The one algorithm among the nouns, because rigs and cages both ask which points are inside, and siblings do not know each other.

#[cfg(test)]
mod fixtures;
mod soup;
mod union_find;
mod winding_number;

pub use soup::Soup;
pub use union_find::UnionFind;
pub use winding_number::{Enclosure, WindingNumber};

/// What is wrong with a surface.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// A coordinate is NaN or infinite.
    #[error("surface vertex {index} is not finite; check the file or the computation it came from")]
    NotFinite {
        /// The vertex.
        index: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {vertex}, but there are only {vertices}")]
    Index {
        /// The triangle.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// Vertices in the mesh.
        vertices: usize,
    },
    /// No triangle has an area.
    #[error("the surface has no triangle with an area")]
    Empty,
}

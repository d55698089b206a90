//! What is read from and written to an asset file.

use crate::{Look, Mesh, Motion, Rig};

/// A model with all that came with it.
#[derive(Clone, Debug, Default)]
pub struct Asset {
    /// The surface, displayed rest pose.
    pub mesh: Mesh,
    /// Looks that the mesh's parts refer to.
    pub looks: Vec<Look>,
    /// Skeleton and weights. Static models get their nodes as joints, see [`Rig::is_articulated`].
    pub rig: Rig,
    /// Clips in the file.
    pub motions: Vec<Motion>,
    /// The file itself, for writing back what we do not interpret.
    pub source: Source,
    /// What the reader had to mend or ignore, one sentence each.
    pub warnings: Vec<String>,
}

/// The document an asset came from.
#[derive(Clone, Debug, Default)]
pub enum Source {
    /// Made by code or read from a format without structure of its own (OBJ, STL, OFF).
    #[default]
    Plain,
    /// glTF 2.0: the JSON as it stood and the binary buffers, all external buffers and images loaded.
    Gltf {
        /// The document.
        json: serde_json::Value,
        /// Buffers in order.
        buffers: Vec<Vec<u8>>,
    },
}

//! What can be wrong with a simulation's input; whose fault it is and where.

/// Errors of the sim crate. Nothing here is a matter of luck: the same input gives the same error.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimError {
    /// A coordinate or parameter is NaN or infinite.
    #[error("{what} {index} is not finite; check the file or the computation it came from")]
    NotFinite {
        /// What kind of thing.
        what: &'static str,
        /// Which one.
        index: usize,
    },
    /// No tets or no vertices.
    #[error("the mesh has no tets")]
    Empty,
    /// A tet names a vertex that does not exist.
    #[error("tet {tet} names vertex {vertex}, but there are only {vertices}")]
    VertexOutOfRange {
        /// The tet.
        tet: usize,
        /// The vertex it names.
        vertex: u32,
        /// Vertices in the mesh.
        vertices: usize,
    },
    /// A rest tet has no volume, relative to its longest edge cubed.
    #[error("tet {tet} is flat at rest (volume {volume:e} m³); remove it or remesh")]
    FlatTet {
        /// The tet.
        tet: usize,
        /// Its signed volume [m³].
        volume: f64,
    },
    /// A rest tet is turned inside out.
    #[error("tet {tet} is inverted at rest (volume {volume:e} m³); swap two of its vertices")]
    InvertedTet {
        /// The tet.
        tet: usize,
        /// Its signed volume [m³].
        volume: f64,
    },
    /// A vertex belongs to no tet.
    #[error("vertex {vertex} belongs to no tet; remove it")]
    LooseVertex {
        /// The vertex.
        vertex: usize,
    },
    /// A driven vertex does not exist or is named twice.
    #[error("driven vertex {vertex} is {problem}")]
    DrivenVertex {
        /// The vertex.
        vertex: u32,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A tet's cluster has no modulus.
    #[error("tet {tet} is in cluster {cluster}, but there are only {clusters} moduli")]
    ClusterOutOfRange {
        /// The tet.
        tet: usize,
        /// Its cluster.
        cluster: u32,
        /// Clusters with a modulus.
        clusters: usize,
    },
    /// A Young's modulus is not a positive number.
    #[error("Young's modulus of cluster {cluster} is {value:e} Pa; it must be positive and finite")]
    Modulus {
        /// The cluster.
        cluster: usize,
        /// The modulus [Pa].
        value: f64,
    },
    /// A scalar parameter is outside its range.
    #[error("{name} is {value}; it must be {range}")]
    OutOfRange {
        /// Name of the parameter.
        name: &'static str,
        /// The value.
        value: f64,
        /// The allowed range in words.
        range: &'static str,
    },
    /// A surface that cannot be filled.
    #[error(transparent)]
    Surface(#[from] animimic_scene::solid::SurfaceError),
    /// An array has the wrong length.
    #[error("{what} has {got} entries, expected {expected}")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its length.
        got: usize,
        /// What it should be.
        expected: usize,
    },
}

/// Ok if the slices' lengths agree.
pub(crate) fn check_len(what: &'static str, got: usize, expected: usize) -> Result<(), SimError> {
    if got == expected { Ok(()) } else { Err(SimError::Length { what, got, expected }) }
}

/// Ok if every vector is finite.
pub(crate) fn check_finite(what: &'static str, values: &[glam::DVec3]) -> Result<(), SimError> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(SimError::NotFinite { what, index }),
        None => Ok(()),
    }
}

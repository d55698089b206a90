//! What can go wrong in this crate.

/// Errors of the renderer.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The mesh contradicts itself.
    #[error("mesh: {0}; the file is damaged, export it again")]
    Mesh(String),
    /// Positions, pictures or masks do not belong together.
    #[error("caller: {0}")]
    Mismatch(String),
}

//! What can go wrong while fitting.

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The inputs do not belong together.
    #[error("{0}")]
    Input(String),
    /// The model cannot be drawn.
    #[error(transparent)]
    Render(#[from] animimic_render::RenderError),
    /// The body cannot be simulated, or its surface cannot be filled.
    #[error(transparent)]
    Sim(#[from] animimic_sim::SimError),
    /// What was done could not be kept.
    #[error("{0}")]
    Keep(String),
    /// The caller asked to stop.
    #[error("stopped")]
    Stopped,
}

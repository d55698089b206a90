//! What can go wrong, by whose fault.

use std::path::PathBuf;

/// Errors of the facade.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A model, camera, npz or other scene file.
    #[error(transparent)]
    Scene(#[from] animimic_scene::io::SceneError),
    /// A video.
    #[error(transparent)]
    Video(animimic_video::VideoError),
    /// A mesh that cannot be drawn.
    #[error(transparent)]
    Render(#[from] animimic_render::RenderError),
    /// A model that cannot be rigged.
    #[error(transparent)]
    Rig(#[from] animimic_rig::riggers::RigError),
    /// Inputs that the fit refuses.
    #[error(transparent)]
    Fit(animimic_fit::FitError),
    /// A body that cannot be simulated, or a surface that cannot be filled.
    #[error(transparent)]
    Sim(#[from] animimic_sim::SimError),
    /// A surface that does not belong to its model.
    #[error(transparent)]
    Helpers(#[from] animimic_rig::helpers::HelperError),
    /// A file could not be read or written.
    #[error("{path}: {source}", path = .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// An input that does not fit the others.
    #[error("{0}")]
    Input(String),
    /// Another run works in the same place.
    #[error("{what}: {holder}, is at work here: wait for it, or name another place", what = .what.display())]
    Busy {
        /// The place.
        what: PathBuf,
        /// The other run, in words.
        holder: String,
    },
    /// The caller asked to stop.
    #[error("stopped on request; nothing was left half-written")]
    Cancelled,
}

impl From<animimic_fit::FitError> for Error {
    fn from(e: animimic_fit::FitError) -> Self {
        match e {
            animimic_fit::FitError::Stopped => Self::Cancelled,
            other => Self::Fit(other),
        }
    }
}

impl From<animimic_video::VideoError> for Error {
    fn from(e: animimic_video::VideoError) -> Self {
        match e {
            animimic_video::VideoError::Stopped => Self::Cancelled,
            other => Self::Video(other),
        }
    }
}

impl Error {
    /// An [`Error::Io`] maker for `map_err`.
    pub(crate) fn io(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}

//! What can go wrong with a video, by whose fault it is.

use std::path::PathBuf;

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, VideoError>;

/// Errors of reading, writing and interpreting videos. Each message says what, where and what to do.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// The file system refused.
    #[error("{path}: {error}", path = .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// The file is broken or not what it should be.
    #[error("{path}: {reason}", path = .path.display())]
    Invalid {
        /// The file or folder.
        path: PathBuf,
        /// One sentence: what is wrong and where.
        reason: String,
    },
    /// The file is sound, but neither the embedded decoder nor an installed ffmpeg can read it.
    #[error("{path}: {reason}; convert it with `{command}`", path = .path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is not supported.
        reason: String,
        /// The command that converts the file into one that can be read.
        command: String,
    },
    /// More memory would be needed than is reasonable.
    #[error("{path}: {reason}", path = .path.display())]
    Limit {
        /// The file.
        path: PathBuf,
        /// What exceeds which limit, and what to do.
        reason: String,
    },
    /// A service or program that makes videos refused, failed, or cannot be understood. Holds no key.
    #[error("{provider}: {reason}")]
    Provider {
        /// The provider's name.
        provider: &'static str,
        /// What happened, and what to do.
        reason: String,
    },
    /// The user asked to stop.
    #[error("stopped on request; nothing was left half-written")]
    Stopped,
    /// The caller asked for something that makes no sense.
    #[error("{0}")]
    Caller(String),
}

impl VideoError {
    /// An [`VideoError::Io`] for some path.
    pub fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |error| Self::Io { path, error }
    }

    /// An [`VideoError::Invalid`] for some path.
    pub fn invalid(path: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        Self::Invalid { path: path.into(), reason: reason.into() }
    }
}

//! What can go wrong with a file, by whose fault it is.

use std::path::Path;

/// Why a file could not be read or written. Every message is one sentence: where, what, and what to do where that helps.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file breaks its format's rules.
    #[error("{place}: {what}")]
    Invalid {
        /// File, and the place in it (JSON pointer, line or byte).
        place: String,
        /// What is wrong there.
        what: String,
    },
    /// The file is (or may be) valid, but this program does not understand it.
    #[error("{place}: {what}")]
    Unsupported {
        /// File, and the place in it.
        place: String,
        /// What is not understood and what to do.
        what: String,
    },
    /// Reading on would take more memory than a well-meant file needs.
    #[error("{place}: {what}")]
    Limit {
        /// File, and the place in it.
        place: String,
        /// The amount asked for and the limit.
        what: String,
    },
    /// The operating system refused.
    #[error("{place}: cannot {action}: {source}")]
    Io {
        /// The file.
        place: String,
        /// What was tried.
        action: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// The caller handed in data that do not belong together.
    #[error("{0}")]
    Caller(String),
}

impl SceneError {
    /// A broken rule at `place`.
    pub fn invalid(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Invalid { place: place.into(), what: what.into() }
    }

    /// Something valid that is not understood, at `place`.
    pub fn unsupported(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Unsupported { place: place.into(), what: what.into() }
    }

    /// Something too large, at `place`.
    pub fn limit(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Limit { place: place.into(), what: what.into() }
    }

    /// A refusal of the operating system while trying to `action` the file.
    pub fn io(path: &Path, action: &'static str, source: std::io::Error) -> Self {
        Self::Io { place: path.display().to_string(), action, source }
    }

    /// The same error with the file's name put before the place.
    pub fn in_file(self, path: &Path) -> Self {
        let file = path.display().to_string();
        let join = |place: String| if place.is_empty() { file.clone() } else { format!("{file} {place}") };
        match self {
            Self::Invalid { place, what } => Self::Invalid { place: join(place), what },
            Self::Unsupported { place, what } => Self::Unsupported { place: join(place), what },
            Self::Limit { place, what } => Self::Limit { place: join(place), what },
            other => other,
        }
    }
}

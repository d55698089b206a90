//! The file that remembers a job: `motion.mp4.job.json` beside `motion.mp4`.

use super::Ticket;
use crate::error::{Result, VideoError};
use crate::write::write_whole;
use std::path::{Path, PathBuf};

/// What is remembered. Holds no key.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct JobFile {
    /// The provider.
    pub provider: String,
    /// SHA-256 of all that was asked for, in hexadecimal.
    pub asked: String,
    /// What was to happen.
    pub prompt: String,
    /// The provider's model.
    pub model: String,
    /// The job.
    pub ticket: Ticket,
    /// Whether the video was fetched.
    pub done: bool,
}

/// Where the job of a video is remembered.
pub fn job_path(out: &Path) -> PathBuf {
    let name = out.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    out.with_file_name(format!("{name}.job.json"))
}

impl JobFile {
    /// The job beside a video, if there is one.
    ///
    /// # Errors
    /// An unreadable file: it may stand for a paid job, so it is not passed over.
    pub fn read(out: &Path) -> Result<Option<Self>> {
        let path = job_path(out);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(VideoError::Io { path, error }),
        };
        serde_json::from_slice(&bytes).map(Some).map_err(|e| {
            VideoError::invalid(&path, format!("this is no job that was written here ({e}); delete it to ask anew"))
        })
    }

    /// Writes the job beside a video.
    ///
    /// # Errors
    /// The disk.
    pub fn write(&self, out: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).expect("text and flags become JSON");
        write_whole(&job_path(out), format!("{text}\n").as_bytes())
    }

    /// Forgets the job beside a video.
    ///
    /// # Errors
    /// The disk.
    pub fn remove(out: &Path) -> Result<()> {
        let path = job_path(out);
        std::fs::remove_file(&path).map_err(VideoError::io(path))
    }
}

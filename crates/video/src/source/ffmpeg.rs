//! A system ffmpeg, where there is one, for what the embedded decoder cannot read.

use crate::error::{Result, VideoError};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Options that make any input into what we read; frame times are kept, rotation is applied.
const CONVERT: [&str; 12] =
    ["-map", "0:v:0", "-an", "-fps_mode", "passthrough", "-c:v", "libx264", "-crf", "10", "-pix_fmt", "yuv420p", "-vf"];
/// 4:2:0 needs even sizes.
const EVEN: &str = "crop=trunc(iw/2)*2:trunc(ih/2)*2";

/// The error for a sound file that we cannot decode, with the command that converts it.
pub fn unsupported(path: &Path, reason: String) -> VideoError {
    let command =
        format!("ffmpeg -i {:?} -an -c:v libx264 -crf 10 -pix_fmt yuv420p converted.mp4", path.display().to_string());
    VideoError::Unsupported { path: path.into(), reason, command }
}

/// Converts with ffmpeg into `folder`. `None` when no ffmpeg can be started.
pub fn convert(path: &Path, folder: &Path) -> Option<Result<PathBuf>> {
    let out = folder.join("converted.mp4");
    let run = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-y", "-i"])
        .arg(path)
        .args(CONVERT)
        .arg(EVEN)
        .arg(&out)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .output()
        .ok()?;
    if run.status.success() && out.is_file() {
        return Some(Ok(out));
    }
    let said = String::from_utf8_lossy(&run.stderr);
    let last = said.lines().rfind(|l| !l.trim().is_empty()).unwrap_or("no reason given").trim().to_string();
    Some(Err(VideoError::invalid(path, format!("ffmpeg cannot read it either ({last})"))))
}

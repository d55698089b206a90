//! A system ffmpeg, where there is one, for what the embedded decoder cannot read.

use crate::error::{Result, VideoError};
use std::io::Read;
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

/// What became of a video.
pub struct Converted {
    /// Its colours.
    pub color: PathBuf,
    /// Its alpha as grey, where it has any.
    pub alpha: Option<PathBuf>,
}

/// The decoders that know the alpha of VP8 and VP9: ffmpeg's own leave it out.
const ALPHA_DECODERS: [(&[u8], &str); 2] = [(b"V_VP8", "libvpx"), (b"V_VP9", "libvpx-vp9")];
/// Matroska's element AlphaMode, one byte long, with the value 1.
const ALPHA_MODE: &[u8] = &[0x53, 0xc0, 0x81, 1];
/// The track's description stands in front of the frames, within so many bytes.
const HEAD_BYTES: u64 = 1 << 16;

/// The decoder that a WebM with alpha needs; `None` for all others.
fn alpha_decoder(path: &Path) -> Option<&'static str> {
    let mut head = Vec::new();
    std::fs::File::open(path).ok()?.take(HEAD_BYTES).read_to_end(&mut head).ok()?;
    let holds = |what: &[u8]| head.windows(what.len()).any(|w| w == what);
    let decoder = ALPHA_DECODERS.iter().find(|d| holds(d.0))?.1;
    holds(ALPHA_MODE).then_some(decoder)
}

/// Converts with ffmpeg into `folder`. `None` when no ffmpeg can be started.
pub fn convert(path: &Path, folder: &Path) -> Option<Result<Converted>> {
    let (color, alpha) = (folder.join("converted.mp4"), folder.join("alpha.mp4"));
    let decoder = alpha_decoder(path);
    let made = run(path, decoder, EVEN, &color)?;
    if made.is_err() || decoder.is_none() {
        return Some(made.map(|()| Converted { color, alpha: None }));
    }
    let made = run(path, decoder, &format!("alphaextract,{EVEN}"), &alpha)?;
    Some(made.map(|()| Converted { color, alpha: Some(alpha) }))
}

/// One conversion through a filter. `None` when no ffmpeg can be started.
fn run(path: &Path, decoder: Option<&str>, filter: &str, out: &Path) -> Option<Result<()>> {
    let run = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-y"])
        .args(decoder.iter().flat_map(|d| ["-c:v", d]))
        .arg("-i")
        .arg(path)
        .args(CONVERT)
        .arg(filter)
        .arg(out)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .output()
        .ok()?;
    if run.status.success() && out.is_file() {
        return Some(Ok(()));
    }
    let said = String::from_utf8_lossy(&run.stderr);
    let last = said.lines().rfind(|l| !l.trim().is_empty()).unwrap_or("no reason given").trim().to_string();
    Some(Err(VideoError::invalid(path, format!("ffmpeg cannot read it either ({last})"))))
}

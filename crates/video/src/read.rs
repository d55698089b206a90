//! Reading any video into frames at a constant rate.

use crate::cut;
use crate::error::{Result, VideoError};
use crate::pixels::{shrink, working_size};
use crate::source::{self, Opened, Picture, ffmpeg};
use crate::timing::{Resampling, resample};
use animimic_scene::{Image, Mask, Video};
use std::io::Read;
use std::ops::Range;
use std::path::Path;

/// Pixels of all frames together that are kept in memory [bytes].
const MAX_VIDEO_BYTES: usize = 8 << 30;
/// Most frames that are read at once: over five minutes at 30 a second.
const MAX_FRAMES: usize = 10_000;
/// Larger share of lost frames is refused.
const MAX_LOST: f64 = 0.05;

/// What to read of a video, and how.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// Highest frame rate; faster videos keep every n-th frame \[1/s\].
    pub max_fps: f64,
    /// Frames are shrunk to this height, aspect kept; never enlarged [px].
    pub working_height: Option<usize>,
    /// Only these frames, counted after resampling.
    pub frames: Option<Range<usize>>,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { max_fps: 30.0, working_height: None, frames: None }
    }
}

/// Reads an MP4 (H.264), GIF, animated WebP or a folder of frames; what the embedded decoders cannot read goes through
/// a system ffmpeg where there is one.
///
/// Errors: not a video, broken, fewer than two frames, more than 5 % of the frames lost, too large for memory, or
/// unsupported without ffmpeg (the message names the command that converts it).
pub fn read(path: &Path, options: &ReadOptions) -> Result<Video> {
    if !(options.max_fps.is_finite() && options.max_fps > 0.0) {
        return Err(VideoError::Caller(format!("the highest frame rate must be positive, not {}", options.max_fps)));
    }
    let head = read_head(path)?;
    let direct = match source::find(path, &head) {
        Some(kind) => kind.open(path).and_then(|opened| decoded(path, opened.as_ref(), options)),
        None => Err(not_a_video(path, &head)),
    };
    let mut video = match direct {
        Err(VideoError::Unsupported { reason, path, command }) => {
            let folder = tempfile::tempdir().map_err(VideoError::io(std::env::temp_dir()))?;
            let Some(converted) = ffmpeg::convert(&path, folder.path()) else {
                return Err(VideoError::Unsupported { reason, path, command });
            };
            let mut video = read_converted(&path, &converted?, options)?;
            video.warnings.push(format!("{reason}: converted by the system's ffmpeg"));
            video
        }
        other => other?,
    };
    cut::trim(&mut video, path)?;
    Ok(video)
}

/// Colour, and alpha where it was converted too, with what the frames are called in the original.
fn read_converted(path: &Path, converted: &ffmpeg::Converted, options: &ReadOptions) -> Result<Video> {
    let open = |file: &Path| decoded(path, source::mp4::Mp4::open_file(file)?.as_ref(), options);
    let mut video = open(&converted.color)?;
    if let Some(alpha) = &converted.alpha {
        let grey = |image: Image| Mask {
            width: image.width,
            height: image.height,
            coverage: image.rgb.iter().map(|p| p[1]).collect(),
        };
        video.alpha = open(alpha)?.frames.into_iter().map(grey).collect();
    }
    Ok(video)
}

fn read_head(path: &Path) -> Result<Vec<u8>> {
    if path.is_dir() {
        return Ok(Vec::new());
    }
    let mut head = Vec::new();
    let file = std::fs::File::open(path).map_err(VideoError::io(path))?;
    file.take(256).read_to_end(&mut head).map_err(VideoError::io(path))?;
    Ok(head)
}

/// Says what a file is that no source takes.
fn not_a_video(path: &Path, head: &[u8]) -> VideoError {
    let text = String::from_utf8_lossy(head).to_lowercase();
    let image = image::guess_format(head).ok();
    if head.is_empty() {
        VideoError::invalid(path, "the file is empty")
    } else if head.starts_with(b"version https://git-lfs") {
        VideoError::invalid(path, "this is a Git-LFS pointer, not the video; run `git lfs pull`")
    } else if text.trim_start().starts_with("<!doctype html") || text.trim_start().starts_with("<html") {
        VideoError::invalid(path, "this is a web page, not a video; download the video itself")
    } else if head.starts_with(&[0x1a, 0x45, 0xdf, 0xa3]) {
        ffmpeg::unsupported(path, "WebM and Matroska are not read directly".into())
    } else if head.starts_with(b"RIFF") && head.get(8..12) == Some(b"AVI ") {
        ffmpeg::unsupported(path, "AVI is not read directly".into())
    } else if image.is_some() {
        VideoError::invalid(path, "this is a still picture, not a video; give an MP4, a GIF or a folder of frames")
    } else {
        VideoError::invalid(
            path,
            "this is not a video; give an H.264 MP4, a GIF, an animated WebP or a folder of frames",
        )
    }
}

fn decoded(path: &Path, opened: &dyn Opened, options: &ReadOptions) -> Result<Video> {
    let times = opened.times_secs();
    let Resampling { fps, mut source } = resample(times, options.max_fps);
    if let Some(range) = &options.frames {
        if range.start >= range.end || range.start >= source.len() {
            let message =
                format!("frames {}..{} are not in the video, which has {}", range.start, range.end, source.len());
            return Err(VideoError::Caller(message));
        }
        source = source[range.start..range.end.min(source.len())].to_vec();
    }
    if source.len() < 2 {
        return Err(VideoError::invalid(path, "the video has one frame only; a motion needs at least two"));
    }
    if source.len() > MAX_FRAMES {
        let reason = format!(
            "{} frames ({:.0} s) are more than the {MAX_FRAMES} that are read at once; give a range of frames",
            source.len(),
            source.len() as f64 / fps
        );
        return Err(VideoError::Limit { path: path.into(), reason });
    }
    let native_size = opened.size();
    let size = working_size(native_size, options.working_height);
    let bytes = size.0.saturating_mul(size.1).saturating_mul(3 * source.len());
    if bytes > MAX_VIDEO_BYTES {
        let reason = format!(
            "{} frames of {}×{} pixels need {:.1} GiB; give a smaller working height or fewer frames",
            source.len(),
            size.0,
            size.1,
            bytes as f64 / f64::from(1 << 30)
        );
        return Err(VideoError::Limit { path: path.into(), reason });
    }
    let mut wanted = vec![false; times.len()];
    for &s in &source {
        wanted[s] = true;
    }
    let mut pictures: Vec<Option<Picture>> = Vec::new();
    pictures.resize_with(times.len(), || None);
    let finish = |picture: Picture| {
        let to = working_size((picture.image.width, picture.image.height), options.working_height);
        shrink(picture, to)
    };
    let report = opened.decode(&|i| wanted[i], &finish, &mut |i, picture| pictures[i] = Some(picture))?;
    let lost = report.promised.saturating_sub(report.sound);
    if lost as f64 > MAX_LOST * report.promised as f64 {
        let reason = format!(
            "only {} of {} frames could be decoded, the rest is damaged; record or download the video again",
            report.sound, report.promised
        );
        return Err(VideoError::invalid(path, reason));
    }
    let mut video = Video { fps, native_size, warnings: report.warnings, ..Video::default() };
    if lost > 0 {
        video
            .warnings
            .push(format!("{} of {} frames decoded, neighbours stand in for the rest", report.sound, report.promised));
    }
    fill(&mut video, path, times, &source, pictures)?;
    Ok(video)
}

/// Puts the decoded pictures in order; a lost one is replaced by the last sound one before it (or the first after it).
fn fill(
    video: &mut Video,
    path: &Path,
    times: &[f64],
    source: &[usize],
    mut pictures: Vec<Option<Picture>>,
) -> Result<()> {
    let mut last_use = vec![0; pictures.len()];
    let sound: Vec<usize> = (0..pictures.len()).filter(|&i| pictures[i].is_some()).collect();
    let stand_in = |s: usize| {
        let after = sound.partition_point(|&i| i <= s);
        sound.get(after.saturating_sub(1)).copied()
    };
    let mut chosen = Vec::with_capacity(source.len());
    for (k, &s) in source.iter().enumerate() {
        let i = stand_in(s).ok_or_else(|| VideoError::invalid(path, "no frame could be decoded"))?;
        last_use[i] = k;
        chosen.push(i);
    }
    let first_size = chosen.first().and_then(|&i| pictures[i].as_ref()).map(|p| (p.image.width, p.image.height));
    for (k, &i) in chosen.iter().enumerate() {
        let picture = if last_use[i] == k {
            pictures[i].take()
        } else {
            pictures[i].as_ref().map(|p| Picture { image: p.image.clone(), alpha: p.alpha.clone() })
        };
        let picture = picture.ok_or_else(|| VideoError::invalid(path, "a frame was used after its last use"))?;
        if Some((picture.image.width, picture.image.height)) != first_size {
            video.warnings.push(format!("the picture size changes at frame {k}; the video was read up to there"));
            break;
        }
        video.frames.push(picture.image);
        video.alpha.extend(picture.alpha);
        video.source_frames.push(source[k]);
        video.source_times_secs.push(times[source[k]]);
    }
    if video.alpha.len() != video.frames.len() {
        video.alpha.clear();
    }
    Ok(())
}

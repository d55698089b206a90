//! Cues of a video as files: `masks.npz` and `tracks.npz` for programs, `overlay.mp4` to look at.

use crate::Error;
use crate::event::{Event, Progress, tell};
use animimic_scene::{Cues, Image, Mask, Video};
use animimic_video::cues;
use std::path::Path;

/// Finds masks and tracks of a video and writes `masks.npz`, `tracks.npz` and `overlay.mp4`; returns statistics.
///
/// # Errors
/// Unreadable video, unwritable folder, or a stop.
pub fn write(
    video: &Path,
    height_px: usize,
    folder: &Path,
    progress: &mut Progress,
) -> Result<serde_json::Value, Error> {
    tell(progress, Event::Stage { name: "reading" })?;
    let options = animimic_video::ReadOptions { working_height: Some(height_px), ..Default::default() };
    let video = animimic_video::read(video, &options)?;
    for warning in &video.warnings {
        tell(progress, Event::Warning(warning.clone()))?;
    }
    tell(progress, Event::Stage { name: "masks" })?;
    let masks = cues::masks(&video, &cues::MaskOptions::default());
    tell(progress, Event::Stage { name: "tracks" })?;
    let tracks = cues::tracks(&video, &masks.masks, &cues::TrackOptions::default());
    tell(progress, Event::Stage { name: "writing" })?;
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    cues::write_masks(&folder.join("masks.npz"), &masks.masks)?;
    cues::write_tracks(&folder.join("tracks.npz"), &tracks)?;
    let seen = tracks.confidence.iter().flatten().filter(|c| **c > 0.0).count();
    let confidence = masks.confidence.iter().copied().fold(1.0, f32::min);
    let statistics = serde_json::json!({
        "frames": video.frames.len(), "fps": video.fps,
        "points": tracks.query_frame.len(), "points_per_frame": seen as f64 / video.frames.len() as f64,
        "mask_confidence_min": confidence,
    });
    let found = Cues { masks: masks.masks, tracks, ..Cues::default() };
    let mut frames = cues::overlay(&video, &found).into_iter();
    animimic_video::write_mp4(&folder.join("overlay.mp4"), &mut frames, video.fps)?;
    Ok(statistics)
}

/// Masks made elsewhere, for the frames of a video: read, picked by the source's frame numbers and brought to its size.
///
/// # Errors
/// Unreadable masks, or another number of frames than the video has.
pub fn masks_for(video: &Video, path: &Path) -> Result<Vec<Mask>, Error> {
    let masks = cues::read_masks(path)?;
    let count = video.frames.len();
    let last = video.source_frames.last().copied().unwrap_or(0);
    let picked: Vec<&Mask> = if masks.len() == count {
        masks.iter().collect()
    } else if video.source_frames.len() == count && last < masks.len() {
        video.source_frames.iter().map(|&k| &masks[k]).collect()
    } else {
        let (path, n) = (path.display(), masks.len());
        return Err(Error::Input(format!(
            "{path}: {n} masks for a video of {count} frames, whose last is number {last}"
        )));
    };
    Ok(picked.into_iter().map(|m| at_size(m, &video.frames[0])).collect())
}

/// The mask at the size of a picture.
fn at_size(mask: &Mask, like: &Image) -> Mask {
    if (mask.width, mask.height) == (like.width, like.height) {
        return mask.clone();
    }
    let gray = Image { width: mask.width, height: mask.height, rgb: mask.coverage.iter().map(|&c| [c; 3]).collect() };
    let out = crate::pictures::resized(&gray, like.width, like.height);
    Mask { width: out.width, height: out.height, coverage: out.rgb.iter().map(|p| p[0]).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_picked_by_source_frame_and_scaled_to_the_video() {
        let folder = std::env::temp_dir().join(format!("animimic-masks-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("m.npz");
        let mask = |on: usize| Mask { width: 8, height: 8, coverage: vec![if on == 1 { 255 } else { 0 }; 64] };
        cues::write_masks(&path, &[mask(0), mask(1), mask(0), mask(1)]).unwrap();
        let frames = vec![Image::filled(4, 4, [0; 3]); 2];
        let video = Video { fps: 12.0, frames, source_frames: vec![0, 3], ..Video::default() };
        let got = masks_for(&video, &path).unwrap();
        assert_eq!((got[0].area(), got[1].area(), got[1].width), (0, 16, 4));
        let short = Video { frames: vec![Image::filled(4, 4, [0; 3]); 9], ..video };
        assert!(masks_for(&short, &path).unwrap_err().to_string().contains("4 masks for a video of 9 frames"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

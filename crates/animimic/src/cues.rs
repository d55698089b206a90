//! Cues of a video as files: `masks.npz` and `tracks.npz` for programs, `overlay.mp4` to look at.

use crate::Error;
use crate::event::{Event, Progress, tell};
use animimic_scene::{Cues, DepthKind, DepthMap, Image, Mask, Tracks, Video};
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
    // Files hold pixels of the video's own size, whatever size was worked at.
    let working_size = (video.frames[0].width, video.frames[0].height);
    cues::write_tracks(&folder.join("tracks.npz"), &resized_tracks(&tracks, working_size, video.native_size))?;
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
    let picked = picked(video, path, masks.len(), "masks")?;
    Ok(picked.into_iter().map(|k| at_size(&masks[k], &video.frames[0])).collect())
}

/// Point tracks made elsewhere, in pixels of the video's own size: read, picked by the source's frame numbers and brought to the
/// working size. A track starts in the first picked frame from its query frame on.
///
/// # Errors
/// Unreadable tracks, or another number of frames than the video has.
pub fn tracks_for(video: &Video, path: &Path) -> Result<Tracks, Error> {
    let tracks = cues::read_tracks(path)?;
    let picked = picked(video, path, tracks.pixels.len(), "frames of tracks")?;
    let scaled = resized_tracks(&tracks, video.native_size, (video.frames[0].width, video.frames[0].height));
    let last = picked.len() - 1;
    let start = |q: &u32| picked.iter().position(|&k| k >= *q as usize).unwrap_or(last) as u32;
    Ok(Tracks {
        pixels: picked.iter().map(|&k| scaled.pixels[k].clone()).collect(),
        confidence: picked.iter().map(|&k| tracks.confidence[k].clone()).collect(),
        query_frame: tracks.query_frame.iter().map(start).collect(),
    })
}

/// Depth made elsewhere, of any size: read and picked by the source's frame numbers.
///
/// # Errors
/// Unreadable depth, or another number of frames than the video has.
pub fn depth_for(video: &Video, path: &Path) -> Result<(Vec<DepthMap>, DepthKind), Error> {
    let (maps, kind) = cues::read_depth(path, DepthKind::default())?;
    let picked = picked(video, path, maps.len(), "depth maps")?;
    Ok((picked.into_iter().map(|k| maps[k].clone()).collect(), kind))
}

/// Which of `n` given frames belong to the frames of a video: all in turn, or those with the source's numbers.
fn picked(video: &Video, path: &Path, n: usize, what: &str) -> Result<Vec<usize>, Error> {
    let count = video.frames.len();
    let last = video.source_frames.last().copied().unwrap_or(0);
    if n == count {
        Ok((0..n).collect())
    } else if video.source_frames.len() == count && last < n {
        Ok(video.source_frames.clone())
    } else {
        let path = path.display();
        Err(Error::Input(format!("{path}: {n} {what} for a video of {count} frames, whose last is number {last}")))
    }
}

/// Tracks measured in pictures of one size, in pixels of another.
fn resized_tracks(tracks: &Tracks, from: (usize, usize), to: (usize, usize)) -> Tracks {
    let (x, y) = (to.0 as f32 / from.0.max(1) as f32, to.1 as f32 / from.1.max(1) as f32);
    let row = |points: &Vec<[f32; 2]>| points.iter().map(|p| [p[0] * x, p[1] * y]).collect();
    Tracks { pixels: tracks.pixels.iter().map(row).collect(), ..tracks.clone() }
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
    fn tracks_are_picked_by_source_frame_and_scaled_to_the_video() {
        let folder = std::env::temp_dir().join(format!("animimic-tracks-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("t.npz");
        let tracks = Tracks {
            pixels: (0..4).map(|t| vec![[t as f32, 8.0]; 3]).collect(),
            confidence: vec![vec![1.0; 3]; 4],
            query_frame: vec![0, 2, 3],
        };
        cues::write_tracks(&path, &tracks).unwrap();
        let frames = vec![Image::filled(4, 4, [0; 3]); 2];
        let video = Video { frames, native_size: (8, 16), source_frames: vec![0, 3], ..Video::default() };
        let got = tracks_for(&video, &path).unwrap();
        assert_eq!((got.pixels[1][0], got.query_frame), ([1.5, 2.0], vec![0, 1, 1]));
        std::fs::remove_dir_all(&folder).unwrap();
    }

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

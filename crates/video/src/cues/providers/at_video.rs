//! Cues of the source's frames and size, at those of the video as it was read.

use crate::error::{Result, VideoError};
use animimic_scene::{Tracks, Video};
use std::path::Path;

/// Which of `n` given frames belong to the frames of a video: all in turn, or those with the source's numbers.
pub(super) fn picked(video: &Video, path: &Path, n: usize, what: &str) -> Result<Vec<usize>> {
    let count = video.frames.len();
    let last = video.source_frames.last().copied().unwrap_or(0);
    if n == count && n > 0 {
        Ok((0..n).collect())
    } else if video.source_frames.len() == count && last < n {
        Ok(video.source_frames.clone())
    } else {
        Err(VideoError::invalid(path, format!("{n} {what} for a video of {count} frames, whose last is number {last}")))
    }
}

/// Tracks measured in pictures of one size, in pixels of another.
pub fn resized_tracks(tracks: &Tracks, from: (usize, usize), to: (usize, usize)) -> Tracks {
    let (x, y) = (to.0 as f32 / from.0.max(1) as f32, to.1 as f32 / from.1.max(1) as f32);
    let row = |points: &Vec<[f32; 2]>| points.iter().map(|p| [p[0] * x, p[1] * y]).collect();
    Tracks { pixels: tracks.pixels.iter().map(row).collect(), ..tracks.clone() }
}

#[cfg(test)]
mod tests {
    use super::super::{Found, MaskFiles, Provider, Sources};
    use super::*;
    use crate::cues::write_masks;
    use animimic_scene::{Image, Mask};

    #[test]
    fn masks_are_picked_by_source_frame_and_scaled_to_the_video() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("m.npz");
        let mask = |on: usize| Mask { width: 8, height: 8, coverage: vec![if on == 1 { 255 } else { 0 }; 64] };
        write_masks(&path, &[mask(0), mask(1), mask(0), mask(1)]).expect("writes");
        let frames = vec![Image::filled(4, 4, [0; 3]); 2];
        let video = Video { fps: 12.0, frames, source_frames: vec![0, 3], ..Video::default() };
        let provide = |video: &Video| {
            let mut found = Found::default();
            MaskFiles.provide(&Sources { file: Some(&path), ..Sources::new(video) }, &mut found)?;
            Ok::<_, VideoError>(found.cues.masks)
        };
        let got = provide(&video).expect("provides");
        assert_eq!((got[0].area(), got[1].area(), got[1].width), (0, 16, 4));
        let short = Video { frames: vec![Image::filled(4, 4, [0; 3]); 9], ..video };
        assert!(provide(&short).expect_err("refused").to_string().contains("4 masks for a video of 9 frames"));
    }
}

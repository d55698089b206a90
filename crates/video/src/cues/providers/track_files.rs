use super::at_video::{picked, resized_tracks};
use super::{Found, Provider, Sources};
use crate::cues::read_tracks;
use crate::error::Result;
use animimic_scene::Tracks;

/// Point tracks made elsewhere, in pixels of the video's own size: picked by the source's frame numbers and brought to the
/// working size. A track starts in the first picked frame from its query frame on.
pub struct TrackFiles;

impl Provider for TrackFiles {
    fn name(&self) -> &'static str {
        "tracks:file"
    }

    fn summary(&self) -> &'static str {
        "point tracks of another program: npz with tracks, visibility, queries"
    }

    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()> {
        let (video, path) = (sources.video, sources.need_file(self)?);
        let last = video.source_frames.last().map_or(0, |k| k + 1);
        let tracks = match read_tracks(path, Some(video.frames.len()))? {
            t if t.pixels.len() == video.frames.len() => t,
            _ => read_tracks(path, Some(last))?,
        };
        let numbers = picked(video, path, tracks.pixels.len(), "frames of tracks")?;
        let scaled = resized_tracks(&tracks, video.native_size, (video.frames[0].width, video.frames[0].height));
        let last = numbers.len() - 1;
        let start = |q: &u32| numbers.iter().position(|&k| k >= *q as usize).unwrap_or(last) as u32;
        found.cues.tracks = Tracks {
            pixels: numbers.iter().map(|&k| scaled.pixels[k].clone()).collect(),
            confidence: numbers.iter().map(|&k| tracks.confidence[k].clone()).collect(),
            query_frame: tracks.query_frame.iter().map(start).collect(),
        };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cues::write_tracks;
    use animimic_scene::{Image, Video};

    #[test]
    fn tracks_are_picked_by_source_frame_and_scaled_to_the_video() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("t.npz");
        let tracks = Tracks {
            pixels: (0..4).map(|t| vec![[t as f32, 8.0]; 3]).collect(),
            confidence: vec![vec![1.0; 3]; 4],
            query_frame: vec![0, 2, 3],
        };
        write_tracks(&path, &tracks).expect("writes");
        let frames = vec![Image::filled(4, 4, [0; 3]); 2];
        let video = Video { frames, native_size: (8, 16), source_frames: vec![0, 3], ..Video::default() };
        let mut found = Found::default();
        let sources = Sources { file: Some(&path), ..Sources::new(&video) };
        TrackFiles.provide(&sources, &mut found).expect("provides");
        let got = found.cues.tracks;
        assert_eq!((got.pixels[1][0], got.query_frame), ([1.5, 2.0], vec![0, 1, 1]));
    }
}

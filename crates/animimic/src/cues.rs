//! Cues of a video as files: `cues.npz` for programs, `overlay.mp4` to look at.

use crate::Error;
use crate::event::{Event, Progress, tell};
use animimic_render::overlay;
use animimic_scene::io::npz::{self, Archive, Array, Values};
use animimic_scene::{Image, Mask, Tracks, Video};
use animimic_video::cues;
use glam::DVec2;
use std::path::Path;

/// Frames of tail behind each point of the overlay.
const TAIL: usize = 6;
const OUTLINE: [u8; 3] = [255, 60, 90];

/// Finds masks and tracks of a video and writes `cues.npz` and `overlay.mp4`; returns statistics.
///
/// `cues.npz` holds `masks` (frames × height × packed columns), `tracks` (frames × points × 2, pixels of the working size),
/// `visibility` and `confidence` (frames × points), `queries` (points × 3: frame, x, y), `width`, `height`, `fps`.
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
    npz::write(folder.join("cues.npz"), &archive(&video, &masks.masks, &tracks))?;
    let mut frames = (0..video.frames.len()).map(|t| overlay(&video, &masks.masks, &tracks, t));
    animimic_video::write_mp4(&folder.join("overlay.mp4"), &mut frames, video.fps)?;
    let seen = tracks.confidence.iter().flatten().filter(|c| **c > 0.0).count();
    let confidence = masks.confidence.iter().copied().fold(1.0, f32::min);
    Ok(serde_json::json!({
        "frames": video.frames.len(), "fps": video.fps,
        "points": tracks.query_frame.len(), "points_per_frame": seen as f64 / video.frames.len() as f64,
        "mask_confidence_min": confidence,
    }))
}

/// The video frame with the mask's outline and coloured tails of the points.
fn overlay(video: &Video, masks: &[Mask], tracks: &Tracks, t: usize) -> Image {
    let mut image = video.frames[t].clone();
    if let Some(mask) = masks.get(t) {
        overlay::contour(&mut image, mask, OUTLINE);
    }
    let place = |t: usize, i: usize| DVec2::new(f64::from(tracks.pixels[t][i][0]), f64::from(tracks.pixels[t][i][1]));
    for i in 0..tracks.query_frame.len() {
        let color = hue(i as f64 * 0.618_033_988_75);
        for s in t.saturating_sub(TAIL)..t {
            if tracks.confidence[s][i] > 0.0 && tracks.confidence[s + 1][i] > 0.0 {
                overlay::line(&mut image, place(s, i), place(s + 1, i), 1.0, color, 0.8);
            }
        }
        if tracks.confidence[t][i] > 0.0 {
            overlay::disc(&mut image, place(t, i), 1.5, color, 0.5 + 0.5 * f64::from(tracks.confidence[t][i]));
        }
    }
    image
}

/// A saturated colour by its place on the colour circle, whole turns from red.
fn hue(turns: f64) -> [u8; 3] {
    [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|shift| {
        let d = ((turns - shift).rem_euclid(1.0) - 0.5).abs();
        ((d * 6.0 - 1.0).clamp(0.0, 1.0) * 255.0) as u8
    })
}

/// Masks as frames × height × packed columns, highest bit first (`numpy.packbits` along x).
pub(crate) fn pack_bits(masks: &[Mask]) -> Array {
    let (width, height) = masks.first().map_or((0, 0), |m| (m.width, m.height));
    let bytes = width.div_ceil(8);
    let mut packed = vec![0u8; masks.len() * height * bytes];
    for (t, mask) in masks.iter().enumerate() {
        for y in 0..height {
            for x in (0..width).filter(|&x| mask.inside(x, y)) {
                packed[(t * height + y) * bytes + x / 8] |= 128 >> (x % 8);
            }
        }
    }
    Array { shape: vec![masks.len(), height, bytes], values: Values::U8(packed) }
}

fn archive(video: &Video, masks: &[Mask], tracks: &Tracks) -> Archive {
    let (frames, points) = (tracks.pixels.len(), tracks.query_frame.len());
    let (width, height) = (video.frames[0].width, video.frames[0].height);
    let queries = (0..points).flat_map(|i| {
        let t = tracks.query_frame[i];
        let [x, y] = tracks.pixels[t as usize][i];
        [t as f32, x, y]
    });
    let flat: Vec<f32> = tracks.confidence.iter().flatten().copied().collect();
    let array = |name: &str, shape: &[usize], values| (name.to_owned(), Array { shape: shape.to_vec(), values });
    let number = |name: &str, n: usize| array(name, &[], Values::I64(vec![n as i64]));
    let arrays = vec![
        ("masks".to_owned(), pack_bits(masks)),
        array("tracks", &[frames, points, 2], Values::F32(tracks.pixels.iter().flatten().flatten().copied().collect())),
        array("visibility", &[frames, points], Values::Bool(flat.iter().map(|c| *c > 0.0).collect())),
        array("confidence", &[frames, points], Values::F32(flat)),
        array("queries", &[points, 3], Values::F32(queries.collect())),
        number("width", width),
        number("height", height),
        array("fps", &[], Values::F64(vec![video.fps])),
    ];
    Archive { arrays }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_archive_has_numpys_bit_order_and_all_points() {
        let mut mask = Mask { width: 10, height: 1, coverage: vec![0; 10] };
        mask.coverage[0] = 255;
        mask.coverage[9] = 200;
        let video = Video { fps: 24.0, frames: vec![Image::filled(10, 1, [0; 3])], ..Video::default() };
        let tracks = Tracks { pixels: vec![vec![[1.5, 0.5]]], confidence: vec![vec![0.0]], query_frame: vec![0] };
        let a = archive(&video, &[mask], &tracks);
        assert_eq!(a.get("masks").unwrap().values, Values::U8(vec![128, 64]));
        assert_eq!(a.get("visibility").unwrap().values, Values::Bool(vec![false]));
        assert_eq!(a.get("queries").unwrap().values, Values::F32(vec![0.0, 1.5, 0.5]));
    }

    #[test]
    fn hues_go_round_the_circle() {
        assert_eq!([hue(0.0), hue(1.0 / 3.0), hue(2.0 / 3.0)], [[255, 0, 0], [0, 255, 0], [0, 0, 255]]);
    }
}

//! Where a shot begins and ends: black frames at the ends, cuts in the middle, stills.

use crate::error::{Result, VideoError};
use animimic_scene::{Image, Video};
use std::path::Path;

/// Side of the thumbnails that are compared [px].
const THUMB: usize = 24;
/// Frames whose brightest thumbnail value is below this are black (limited-range black with noise).
const BLACK: f32 = 24.0;
/// A cut changes the thumbnail by at least this much on average [levels] …
const CUT_CHANGE: f32 = 18.0;
/// … over at least this share of its cells (an object that jumps on its background changes fewer) …
const CUT_SHARE: f32 = 0.6;
/// … and by at least this many times the video's usual change.
const CUT_RATIO: f32 = 6.0;

/// Drops black frames at both ends and everything from the first cut on, with a warning each.
///
/// Errors: only black frames, or fewer than two frames left.
pub fn trim(video: &mut Video, path: &Path) -> Result<()> {
    let thumbs: Vec<Vec<[f32; 3]>> = video.frames.iter().map(thumbnail).collect();
    let is_black = |t: &Vec<[f32; 3]>| t.iter().flatten().all(|&v| v < BLACK);
    let Some(start) = thumbs.iter().position(|t| !is_black(t)) else {
        return Err(VideoError::invalid(path, "every frame is black"));
    };
    let mut end = thumbs.iter().rposition(|t| !is_black(t)).unwrap_or(start) + 1;
    if start > 0 {
        video.warnings.push(format!("{start} black frames at the start were dropped"));
    }
    if end < thumbs.len() {
        video.warnings.push(format!("{} black frames at the end were dropped", thumbs.len() - end));
    }
    if let Some(cut) = find_cut(&thumbs[start..end]) {
        end = start + cut;
        video.warnings.push(format!(
            "the scene changes at {:.2} s (frame {end}); the video was read up to there",
            end as f64 / video.fps
        ));
    }
    if end - start < 2 {
        return Err(VideoError::invalid(path, "fewer than two frames belong to one shot; a motion needs at least two"));
    }
    if thumbs[start..end].windows(2).all(|w| w[0] == w[1]) && video.frames[start..end].windows(2).all(|w| w[0] == w[1])
    {
        video.warnings.push("all frames are equal: nothing moves in this video".into());
    }
    keep(video, start, end);
    Ok(())
}

fn keep(video: &mut Video, start: usize, end: usize) {
    fn cut<T>(list: &mut Vec<T>, start: usize, end: usize) {
        if !list.is_empty() {
            list.truncate(end);
            list.drain(..start);
        }
    }
    cut(&mut video.frames, start, end);
    cut(&mut video.alpha, start, end);
    cut(&mut video.source_frames, start, end);
    cut(&mut video.source_times_secs, start, end);
}

/// First frame of the second shot.
fn find_cut(thumbs: &[Vec<[f32; 3]>]) -> Option<usize> {
    let changes: Vec<(f32, f32)> = thumbs.windows(2).map(|w| change(&w[0], &w[1])).collect();
    let mut sorted: Vec<f32> = changes.iter().map(|c| c.0).collect();
    sorted.sort_by(f32::total_cmp);
    let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    // With one or two changes the median is the cut itself.
    let usual = if changes.len() < 4 { 0.0 } else { usual };
    let at =
        changes.iter().position(|&(mean, share)| mean > CUT_CHANGE && share > CUT_SHARE && mean > CUT_RATIO * usual)?;
    Some(at + 1)
}

/// Mean absolute change and share of cells that change visibly.
fn change(a: &[[f32; 3]], b: &[[f32; 3]]) -> (f32, f32) {
    let cell = |(p, q): (&[f32; 3], &[f32; 3])| (0..3).map(|k| (p[k] - q[k]).abs()).sum::<f32>() / 3.0;
    let n = a.len().max(1) as f32;
    let mean = a.iter().zip(b).map(cell).sum::<f32>() / n;
    let share = a.iter().zip(b).filter(|&pair| cell(pair) > 0.5 * CUT_CHANGE).count() as f32 / n;
    (mean, share)
}

fn thumbnail(image: &Image) -> Vec<[f32; 3]> {
    let mut out = Vec::with_capacity(THUMB * THUMB);
    for j in 0..THUMB {
        for i in 0..THUMB {
            let (x0, x1) = (i * image.width / THUMB, ((i + 1) * image.width / THUMB).max(i * image.width / THUMB + 1));
            let (y0, y1) =
                (j * image.height / THUMB, ((j + 1) * image.height / THUMB).max(j * image.height / THUMB + 1));
            let mut sum = [0u32; 3];
            for y in y0..y1.min(image.height) {
                for p in &image.rgb[y * image.width + x0..y * image.width + x1.min(image.width)] {
                    for k in 0..3 {
                        sum[k] += u32::from(p[k]);
                    }
                }
            }
            let n = ((x1 - x0) * (y1 - y0)).max(1) as f32;
            out.push(sum.map(|s| s as f32 / n));
        }
    }
    out
}

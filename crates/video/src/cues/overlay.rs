//! Cues drawn over the video, for people to check.

use animimic_scene::{Cues, Image, Video};

/// Frames of track history that are drawn.
const TAIL: usize = 8;
/// Colour of the mask's contour.
const CONTOUR: [u8; 3] = [255, 0, 160];

/// The frames with the mask's contour and every seen track with its tail, coloured by where it started.
pub fn overlay(video: &Video, cues: &Cues) -> Vec<Image> {
    (0..video.frames.len()).map(|t| overlay_frame(video, cues, t)).collect()
}

fn overlay_frame(video: &Video, cues: &Cues, t: usize) -> Image {
    let mut image = video.frames[t].clone();
    let (w, h) = (image.width, image.height);
    if let Some(mask) = cues.masks.get(t).filter(|m| (m.width, m.height) == (w, h)) {
        for y in 0..h {
            for x in 0..w {
                let edge = mask.inside(x, y)
                    && (x == 0
                        || y == 0
                        || x + 1 == w
                        || y + 1 == h
                        || !(mask.inside(x - 1, y)
                            && mask.inside(x + 1, y)
                            && mask.inside(x, y - 1)
                            && mask.inside(x, y + 1)));
                if edge {
                    image.rgb[y * w + x] = CONTOUR;
                }
            }
        }
    }
    let tracks = &cues.tracks;
    let (Some(pixels), Some(confidence)) = (tracks.pixels.get(t), tracks.confidence.get(t)) else { return image };
    for k in 0..pixels.len().min(confidence.len()) {
        if confidence[k] <= 0.0 {
            continue;
        }
        let start = tracks.pixels[tracks.query_frame.get(k).map_or(0, |&q| q as usize).min(tracks.pixels.len() - 1)][k];
        let color = color_of(start, w, h);
        let mut s = t;
        while s > 0 && t - s < TAIL && tracks.confidence[s - 1][k] > 0.0 {
            line(&mut image, tracks.pixels[s - 1][k], tracks.pixels[s][k], color);
            s -= 1;
        }
        for dy in -1..=0 {
            for dx in -1..=0 {
                dot(&mut image, pixels[k][0] + dx as f32 + 0.5, pixels[k][1] + dy as f32 + 0.5, color);
            }
        }
    }
    image
}

/// A hue by column, lighter by row.
fn color_of(p: [f32; 2], w: usize, h: usize) -> [u8; 3] {
    let hue = 6.0 * (p[0] / w as f32).clamp(0.0, 0.999);
    let light = 0.6 + 0.4 * (p[1] / h as f32).clamp(0.0, 1.0);
    [0.0, 4.0, 2.0].map(|shift: f32| {
        let k = (hue + shift) % 6.0;
        (255.0 * light * (((k - 3.0).abs() - 1.0).clamp(0.0, 1.0))) as u8
    })
}

fn dot(image: &mut Image, x: f32, y: f32, color: [u8; 3]) {
    if x >= 0.0 && y >= 0.0 && (x as usize) < image.width && (y as usize) < image.height {
        image.rgb[y as usize * image.width + x as usize] = color;
    }
}

fn line(image: &mut Image, a: [f32; 2], b: [f32; 2], color: [u8; 3]) {
    let steps = (b[0] - a[0]).abs().max((b[1] - a[1]).abs()).ceil().min(4096.0) as usize;
    for i in 0..=steps {
        let s = i as f32 / steps.max(1) as f32;
        dot(image, a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), color);
    }
}

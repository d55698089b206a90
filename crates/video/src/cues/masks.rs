//! Masks on a plain background: difference to a background model, largest regions, soft edge.
//!
//! Inside the edge band a pixel is a mixture α·object + (1 − α)·background, so that α = ΔY / ΔY_object with the *luma*
//! difference: the chroma of 4:2:0 video reaches two pixels beyond the object (its halo costs 3 % IoU).

use super::background::Background;
use super::regions::{depth, regions};
use animimic_scene::{Image, Mask, Video};
use rayon::prelude::*;

/// Settings of [`masks`].
#[derive(Clone, Debug)]
pub struct MaskOptions {
    /// Difference to the background beyond which a pixel is object [levels].
    pub threshold: f32,
    /// Width of the band at the edge in which coverage is measured by luma contrast [px].
    pub band: f32,
    /// Regions smaller than this share of the largest are dropped.
    pub smallest_share: f64,
}

impl Default for MaskOptions {
    fn default() -> Self {
        Self { threshold: 14.0, band: 3.0, smallest_share: 0.003 }
    }
}

/// Masks with what they rest on.
#[derive(Clone, Debug, Default)]
pub struct MaskCue {
    /// Coverage \[frame\].
    pub masks: Vec<Mask>,
    /// The background that was found; no frames in it when the masks came from the video's own alpha.
    pub background: Background,
    /// In \[0, 1\] \[frame\]: low where the border does not look like a plain background.
    pub confidence: Vec<f32>,
}

/// Luma contrast below which chroma decides as well [levels].
const MIN_LUMA_CONTRAST: f32 = 18.0;
/// Corner in which small static regions are watermarks (share of width and height).
const CORNER: (f64, f64) = (0.25, 0.15);
/// A watermark is at most this share of the object.
const WATERMARK_SHARE: f64 = 0.05;
/// Residual at the border at which confidence has fallen to a half [levels].
const HALF_CONFIDENCE: f64 = 6.0;

/// Masks of the object in front of a plain background; the video's own alpha where it has one.
pub fn masks(video: &Video, options: &MaskOptions) -> MaskCue {
    if video.frames.is_empty() {
        return MaskCue::default();
    }
    if video.alpha.len() == video.frames.len() {
        let confidence = vec![1.0; video.frames.len()];
        return MaskCue { masks: video.alpha.clone(), background: Background::default(), confidence };
    }
    let segment_all = |background: &Background| -> Vec<Mask> {
        (0..video.frames.len()).into_par_iter().map(|t| segment(&video.frames[t], t, background, options)).collect()
    };
    let first = Background::from_border(video);
    let rough = segment_all(&first);
    // A margin keeps shadows and halos at the object's edge out of the second fit.
    let margin = (video.frames[0].height / 32).max(3) as f32;
    let near: Vec<Vec<f32>> =
        rough.par_iter().map(|m| depth(&m.coverage.iter().map(|&c| c < 128).collect::<Vec<_>>(), m.width)).collect();
    let width = video.frames[0].width;
    let background = first.refitted(video, &|t, x, y| near[t][y * width + x] < margin);
    let masks = segment_all(&background);
    let confidence = background.residual.iter().map(|r| (1.0 / (1.0 + (r / HALF_CONFIDENCE).powi(2))) as f32).collect();
    MaskCue { masks, background, confidence }
}

/// Difference to the background: luma (signed) and the largest channel difference.
struct Difference {
    luma: Vec<f32>,
    color: Vec<f32>,
}

impl Difference {
    fn new(image: &Image, t: usize, background: &Background) -> Self {
        let n = image.rgb.len();
        let (mut luma, mut color) = (Vec::with_capacity(n), Vec::with_capacity(n));
        for y in 0..image.height {
            for x in 0..image.width {
                let b = background.at(image, t, x, y);
                let d: [f32; 3] = std::array::from_fn(|c| f32::from(image.at(x, y)[c]) - b[c]);
                luma.push(0.299 * d[0] + 0.587 * d[1] + 0.114 * d[2]);
                color.push(d.iter().fold(0.0, |m, v| v.abs().max(m)));
            }
        }
        Self { luma, color }
    }
}

fn segment(image: &Image, t: usize, background: &Background, options: &MaskOptions) -> Mask {
    let (w, h) = (image.width, image.height);
    let difference = Difference::new(image, t, background);
    let set: Vec<bool> = difference.color.iter().map(|&d| d > options.threshold).collect();
    let kept = kept_regions(&set, w, h, options);
    let coverage = soft_edge(&kept, &difference, w, options);
    Mask { width: w, height: h, coverage }
}

/// The largest region and those not much smaller, without corner watermarks; pinholes are closed.
fn kept_regions(set: &[bool], w: usize, h: usize, options: &MaskOptions) -> Vec<bool> {
    let mut kept = vec![false; set.len()];
    let list = regions(set, w);
    let Some(largest) = list.first().map(|r| r.pixels.len() as f64) else { return kept };
    for (k, region) in list.iter().enumerate() {
        let area = region.pixels.len() as f64;
        if area < options.smallest_share * largest || area < 12.0 {
            break;
        }
        let near_side = (region.x.1 as f64) < CORNER.0 * w as f64 || (region.x.0 as f64) > (1.0 - CORNER.0) * w as f64;
        let near_end = (region.y.1 as f64) < CORNER.1 * h as f64 || (region.y.0 as f64) > (1.0 - CORNER.1) * h as f64;
        if k > 0 && near_side && near_end && area < WATERMARK_SHARE * largest {
            continue;
        }
        for &i in &region.pixels {
            kept[i as usize] = true;
        }
    }
    let gaps: Vec<bool> = kept.iter().map(|k| !k).collect();
    let smallest_gap = (options.smallest_share * largest).max(12.0);
    for gap in regions(&gaps, w) {
        if !gap.touches_border(w, h) && (gap.pixels.len() as f64) < smallest_gap {
            for &i in &gap.pixels {
                kept[i as usize] = true;
            }
        }
    }
    kept
}

/// Coverage: 255 deep inside; in the edge band the luma (or, without luma contrast, colour) relative to the object's.
fn soft_edge(kept: &[bool], difference: &Difference, w: usize, options: &MaskOptions) -> Vec<u8> {
    let h = kept.len() / w;
    let inner = depth(kept, w);
    let reach = options.band.ceil() as usize + 1;
    let mut coverage = vec![0u8; kept.len()];
    for y in 0..h {
        for x in 0..w {
            let i = y * w + x;
            if !kept[i] {
                continue;
            }
            if inner[i] > options.band {
                coverage[i] = 255;
                continue;
            }
            // The object's own contrast: mean over the deepest pixels of the neighbourhood.
            let (mut luma, mut color, mut weight) = (0.0f32, 0.0f32, 0.0f32);
            for v in y.saturating_sub(reach)..(y + reach + 1).min(h) {
                for u in x.saturating_sub(reach)..(x + reach + 1).min(w) {
                    let j = v * w + u;
                    if kept[j] {
                        let k = inner[j].min(options.band + 1.0).powi(4);
                        luma += k * difference.luma[j];
                        color += k * difference.color[j];
                        weight += k;
                    }
                }
            }
            let (luma, color) = (luma / weight, color / weight);
            let alpha = if luma.abs() >= MIN_LUMA_CONTRAST {
                difference.luma[i] / luma
            } else {
                difference.color[i] / color.max(1.0)
            };
            coverage[i] = (255.0 * alpha.clamp(0.0, 1.0)).round() as u8;
        }
    }
    coverage
}

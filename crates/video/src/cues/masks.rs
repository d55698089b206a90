//! Masks on a plain background: difference to a background model, largest regions, soft edge.
//!
//! Two thresholds: beyond the upper a pixel is object; down to the lower, which follows the background's own noise, it is
//! where it forms areas and not just the ringing that compression leaves around edges (white fur on light grey).
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
/// A gap whose median difference exceeds this share of the lower threshold is not background.
const OWN_COLOR: f32 = 0.4;
/// How much deeper the pixels lie whose contrast is the object's [px]: beyond the mixture, yet the same shade.
const DEEPER: (f32, f32) = (1.0, 2.7);
/// How much of an object's contrast may be shading toward its edge [levels].
const SHADING: f32 = 32.0;
/// Luma of the opposite sign beyond this is more than ringing [levels].
const RIM_CONTRAST: f32 = 6.0;
/// The lower threshold is this far above the noise: factor on its 99.5th percentile, plus levels; never below the third.
const NOISE_FACTOR: f32 = 1.5;
const NOISE_MARGIN: f32 = 1.5;
const MIN_THRESHOLD: f32 = 3.5;
/// Ringing reaches this far from an edge; weak areas are wider than twice this [px at 512 rows].
const RINGING: f32 = 2.0;
/// Notches in weak areas up to twice this width are closed [px at 512 rows].
const NOTCH: f32 = 4.0;
/// Gaps whose rim differs less than this from the background are places where the object has the background's colour.
const WEAK_RIM: f32 = 24.0;
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
    match plain(video, options) {
        Some(found) => {
            let masks = found.segment_all(video, options);
            let confidence = found.confidence();
            MaskCue { masks, background: found.background, confidence }
        }
        None => MaskCue::default(),
    }
}

/// A plain background and what can be told from it.
pub(super) struct Plain {
    pub background: Background,
    /// The lower threshold [levels].
    pub weak: f32,
}

impl Plain {
    fn segment_all(&self, video: &Video, options: &MaskOptions) -> Vec<Mask> {
        let one = |t: usize| segment(&video.frames[t], t, &self.background, options, self.weak);
        (0..video.frames.len()).into_par_iter().map(one).collect()
    }

    /// Confidence in the masks \[frame\].
    pub fn confidence(&self) -> Vec<f32> {
        self.background.residual.iter().map(|r| (1.0 / (1.0 + (r / HALF_CONFIDENCE).powi(2))) as f32).collect()
    }
}

/// Fits the background; `None` for a video without frames or with its own alpha.
pub(super) fn plain(video: &Video, options: &MaskOptions) -> Option<Plain> {
    let frame = video.frames.first().filter(|_| video.alpha.len() != video.frames.len())?;
    let first = Plain { background: Background::from_border(video), weak: options.threshold };
    let rough = first.segment_all(video, options);
    // A margin keeps shadows and halos at the object's edge out of the second fit.
    let margin = (frame.height / 32).max(3) as f32;
    let near: Vec<Vec<f32>> =
        rough.par_iter().map(|m| depth(&m.coverage.iter().map(|&c| c < 128).collect::<Vec<_>>(), m.width)).collect();
    let width = frame.width;
    let background = first.background.refitted(video, &|t, x, y| near[t][y * width + x] < margin);
    let weak = weak_threshold(video, &background, &near, margin, options);
    Some(Plain { background, weak })
}

/// Difference to the background: luma (signed) and the largest channel difference.
pub(super) struct Difference {
    pub luma: Vec<f32>,
    pub color: Vec<f32>,
}

impl Difference {
    pub fn new(image: &Image, t: usize, background: &Background) -> Self {
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

/// The lower threshold, from the background's noise away from the object.
fn weak_threshold(
    video: &Video,
    background: &Background,
    near: &[Vec<f32>],
    margin: f32,
    options: &MaskOptions,
) -> f32 {
    let step = (video.frames.len() / 6).max(1);
    let mut noise: Vec<f32> = (0..video.frames.len())
        .step_by(step)
        .flat_map(|t| {
            let color = Difference::new(&video.frames[t], t, background).color;
            let away = color.into_iter().zip(&near[t]).filter(|(_, n)| **n >= margin);
            away.map(|(d, _)| d).collect::<Vec<f32>>()
        })
        .collect();
    if noise.is_empty() {
        return options.threshold;
    }
    let at = (noise.len() * 995 / 1000).min(noise.len() - 1);
    let level = *noise.select_nth_unstable_by(at, f32::total_cmp).1;
    (NOISE_FACTOR * level + NOISE_MARGIN).max(MIN_THRESHOLD).min(options.threshold)
}

fn segment(image: &Image, t: usize, background: &Background, options: &MaskOptions, weak: f32) -> Mask {
    let (w, h) = (image.width, image.height);
    let difference = Difference::new(image, t, background);
    let mut set: Vec<bool> = difference.color.iter().map(|&d| d > options.threshold).collect();
    if weak < options.threshold {
        let scale = h as f32 / 512.0;
        add_weak_areas(&mut set, &difference.color, weak, w, (RINGING * scale).max(1.0));
        close_weak_gaps(&mut set, &difference.color, weak, w, (NOTCH * scale).max(1.0));
    }
    let kept = kept_regions(&set, w, h, options);
    let coverage = soft_edge(&kept, &difference, w, options, |_| 0.0);
    Mask { width: w, height: h, coverage }
}

/// Pixels within `radius` of set ones.
fn dilated(set: &[bool], w: usize, radius: f32) -> Vec<bool> {
    let outside: Vec<bool> = set.iter().map(|s| !s).collect();
    depth(&outside, w).into_iter().map(|d| d <= radius).collect()
}

/// Adds weak pixels that form areas: opened by `ringing`, then grown back.
fn add_weak_areas(set: &mut [bool], color: &[f32], weak: f32, w: usize, ringing: f32) {
    let candidates: Vec<bool> = set.iter().zip(color).map(|(&s, &d)| !s && d > weak).collect();
    let core: Vec<bool> = depth(&candidates, w).into_iter().map(|d| d > ringing).collect();
    let grown = dilated(&core, w, ringing + 1.5);
    for ((s, c), g) in set.iter_mut().zip(candidates).zip(grown) {
        *s |= c && g;
    }
}

/// Fills holes and notches (up to twice `radius` wide) with a weak rim: there the object has the background's colour.
fn close_weak_gaps(set: &mut [bool], color: &[f32], weak: f32, w: usize, radius: f32) {
    let h = set.len() / w;
    let wide = dilated(set, w, radius);
    let closed: Vec<bool> = depth(&wide, w).into_iter().map(|d| d > radius).collect();
    let outside: Vec<bool> = set.iter().map(|s| !s).collect();
    let mut gap: Vec<bool> = closed.iter().zip(set.iter()).map(|(&c, &s)| c && !s).collect();
    let mut in_hole = vec![false; set.len()];
    for hole in regions(&outside, w).iter().filter(|r| !r.touches_border(w, h)) {
        for &i in &hole.pixels {
            gap[i as usize] = true;
            in_hole[i as usize] = true;
        }
    }
    for region in regions(&gap, w) {
        let position = |&i: &u32| (i as usize % w, i as usize / w);
        let rim = region.pixels.iter().map(position).filter(|&(x, y)| rim_touches(set, w, h, x, y));
        let rim = median(rim.map(|(x, y)| strongest(color, w, h, x, y)).collect());
        // True background keeps to the model but for its noise; at open edges ringing does not.
        let inside = median(region.pixels.iter().map(|&i| color[i as usize]).collect());
        let is_hole = region.pixels.iter().all(|&i| in_hole[i as usize]);
        if rim < WEAK_RIM || (is_hole && inside > OWN_COLOR * weak) {
            for &i in &region.pixels {
                set[i as usize] = true;
            }
        }
    }
}

fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
}

/// Whether a pixel has a set neighbour.
fn rim_touches(set: &[bool], w: usize, h: usize, x: usize, y: usize) -> bool {
    let i = y * w + x;
    (x > 0 && set[i - 1]) || (x + 1 < w && set[i + 1]) || (y > 0 && set[i - w]) || (y + 1 < h && set[i + w])
}

/// The largest difference within reach of a pixel: an antialiased edge is weak only in its outermost pixels.
fn strongest(color: &[f32], w: usize, h: usize, x: usize, y: usize) -> f32 {
    const REACH: usize = 3;
    let rows = y.saturating_sub(REACH)..(y + REACH + 1).min(h);
    let columns = x.saturating_sub(REACH)..(x + REACH + 1).min(w);
    rows.flat_map(|v| color[v * w + columns.start..v * w + columns.end].iter().copied()).fold(0.0, f32::max)
}

/// The largest region and those not much smaller, without corner watermarks; pinholes are closed.
pub(super) fn kept_regions(set: &[bool], w: usize, h: usize, options: &MaskOptions) -> Vec<bool> {
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

/// `lean`: distance [px] to an outline known otherwise (positive inside); its
/// inside is kept as far as contrast is weak.
///
/// Coverage: 255 deep inside; in the edge band the luma (or, without luma contrast, colour) relative to the object's.
pub(super) fn soft_edge(
    kept: &[bool],
    difference: &Difference,
    w: usize,
    options: &MaskOptions,
    lean: impl Fn(usize) -> f32,
) -> Vec<u8> {
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
            // The object's own contrast: mean over pixels a little deeper, or the deepest of thin parts.
            let (mut luma, mut color, mut weight) = (0.0f32, 0.0f32, 0.0f32);
            let deeper = |k: f32| {
                let step = k - inner[i];
                if (DEEPER.0..=DEEPER.1).contains(&step) { 1.0 } else { 1e-4 * k.min(options.band + 1.0).powi(4) }
            };
            for v in y.saturating_sub(reach)..(y + reach + 1).min(h) {
                for u in x.saturating_sub(reach)..(x + reach + 1).min(w) {
                    let j = v * w + u;
                    if kept[j] {
                        let k = deeper(inner[j]);
                        luma += k * difference.luma[j];
                        color += k * difference.color[j];
                        weight += k;
                    }
                }
            }
            let (luma, color) = (luma / weight, color / weight);
            // Lighter than the background where the object behind is darker: no mixture of the two, but a rim of its own.
            let own_rim = difference.luma[i] * luma < 0.0 && difference.luma[i].abs() > RIM_CONTRAST;
            let alpha = if own_rim {
                1.0
            } else if luma.abs() >= MIN_LUMA_CONTRAST {
                difference.luma[i] / luma
            } else {
                difference.color[i] / color.max(1.0)
            };
            let alpha = alpha + lean(i).max(0.0) * (SHADING / luma.abs().max(MIN_LUMA_CONTRAST)).min(1.0);
            coverage[i] = (255.0 * alpha.clamp(0.0, 1.0)).round() as u8;
        }
    }
    coverage
}

/// Coverage without knowledge of colours: the labels smoothed by a pixel, the outline kept at a half.
pub(super) fn feathered(kept: &[bool], w: usize) -> Vec<u8> {
    let h = kept.len() / w;
    let inner = |i: usize| u32::from(kept[i]);
    (0..kept.len())
        .map(|i| {
            let (x, y) = (i % w, i / w);
            let (left, right) = (if x > 0 { i - 1 } else { i }, if x + 1 < w { i + 1 } else { i });
            let (above, below) = (if y > 0 { i - w } else { i }, if y + 1 < h { i + w } else { i });
            let sum = 4 * inner(i) + inner(left) + inner(right) + inner(above) + inner(below);
            // The pixel itself weighs a half: its label decides on which side of the outline it lies.
            let coverage = (255 * sum / 8) as u8;
            if kept[i] { coverage.max(128) } else { coverage.min(127) }
        })
        .collect()
}

//! Masks from the known silhouette of frame 0, on any background: a minimum cut per frame.
//!
//! E(a) = Σ_i a_i (−U_i) + λ Σ_{ij} |a_i − a_j| / ‖i − j‖ · exp(−Δ_ij² / 2s²), a ∈ {0, 1}. U adds up
//! - how unlike the background a pixel is: the plain surface of [`super::background`], or on clutter a [`Plate`] that
//!   grows with the video (contrast that the plate shows too is no outline; Sun, Zhang, Tang, Shum: Background Cut, 2006),
//! - on clutter, how like the object its colour is ([`Colors`]),
//! - the signed distance to the previous outline, carried along by optical flow and trusted where the flow there and back
//!   agree.

use super::colors::Colors;
use super::masks::{Difference, MaskCue, MaskOptions, Plain, feathered, kept_regions, plain, soft_edge};
use super::max_flow::Graph;
use super::plate::Plate;
use super::regions::{depth, regions};
use crate::error::{Result, VideoError};
use crate::flow::{Flow, FlowOptions, Gray, consistency, neighbours};
use animimic_scene::{Image, Mask, Video};

/// Integer units of one unit of energy.
const UNIT: f32 = 256.0;
/// Weight λ of the outline, units of energy per pixel of length.
const OUTLINE: f32 = 6.0;
/// Scale s of contrast on a plain background, and the least on clutter [levels].
const CONTRAST: f32 = 6.0;
/// Largest pull of the carried outline, and the distance at which it is reached [px at 512 rows].
const PRIOR: f32 = 2.0;
const PRIOR_REACH: f32 = 2.0;
/// Forward–backward error at which the carried outline is half trusted [px], plus a twentieth of the step.
const HALF_TRUST: f32 = 1.0;
/// Pixels this far from any doubt keep their label [px at 512 rows].
const CERTAIN: f32 = 4.0;
/// Distance to the silhouette beyond which frame 0 shows background for sure [px at 512 rows].
const CLEAR: f32 = 12.0;
/// Share of such pixels that may differ from a plain background.
const CLUTTER_SHARE: f64 = 0.02;

/// Masks of the object whose silhouette in frame 0 is `first`: better than [`super::masks`] where the object has the
/// background's colours, and the way on cluttered, moving backgrounds. The video's own alpha where it has one.
///
/// Confidence is low on frames whose background could not be told apart from change.
///
/// # Errors
/// [`VideoError::Caller`] when `first` has another size than the video or is empty.
pub fn masks_with_prior(video: &Video, first: &Mask, options: &MaskOptions) -> Result<MaskCue> {
    let Some(frame) = video.frames.first() else { return Ok(MaskCue::default()) };
    if (first.width, first.height) != (frame.width, frame.height) {
        return Err(VideoError::Caller(format!(
            "the silhouette of frame 0 is {}×{}, the video {}×{}",
            first.width, first.height, frame.width, frame.height
        )));
    }
    if first.area() == 0 {
        return Err(VideoError::Caller("the silhouette of frame 0 is empty".into()));
    }
    let Some(start) = plain(video, options) else { return Ok(super::masks(video, options)) };
    let scale = frame.height as f32 / 512.0;
    let outline = signed_distance(&first.coverage.iter().map(|&c| c >= 128).collect::<Vec<_>>(), first.width);
    let flows = neighbours(&video.frames, &FlowOptions::default());
    let job = Job { video, options, scale, flows };
    let cluttered = is_cluttered(frame, &start, &outline, CLEAR * scale, options);
    Ok(if cluttered { job.on_clutter(start, outline) } else { job.on_plain(start, outline) })
}

/// Whether what lies clearly outside the silhouette of frame 0 does not look plain.
fn is_cluttered(frame: &Image, start: &Plain, outline: &[f32], clear: f32, options: &MaskOptions) -> bool {
    let difference = Difference::new(frame, 0, &start.background);
    let outside = || difference.color.iter().zip(outline).filter(|(_, d)| **d < -clear);
    let unlike = outside().filter(|(c, _)| **c > options.threshold).count();
    unlike as f64 > CLUTTER_SHARE * outside().count() as f64
}

/// Distance to the outline [px]: positive inside.
fn signed_distance(inside: &[bool], w: usize) -> Vec<f32> {
    let outside: Vec<bool> = inside.iter().map(|i| !i).collect();
    let (a, b) = (depth(inside, w), depth(&outside, w));
    a.iter().zip(&b).map(|(i, o)| if *i > 0.0 { i - 0.5 } else { 0.5 - o }).collect()
}

struct Job<'a> {
    video: &'a Video,
    options: &'a MaskOptions,
    /// Pixels per pixel at 512 rows.
    scale: f32,
    flows: Vec<(Flow, Flow)>,
}

/// The previous outline in the present frame.
struct Carried {
    /// Signed distance [px].
    distance: Vec<f32>,
    /// Trust in \[0, 1\].
    trust: Vec<f32>,
}

impl Job<'_> {
    fn carried(&self, t: usize, outline: &[f32]) -> Carried {
        if t == 0 {
            return Carried { distance: outline.to_vec(), trust: vec![1.0; outline.len()] };
        }
        let (forward, back) = &self.flows[t - 1];
        self.carried_by(forward, back, outline)
    }

    /// The outline carried along `forward`; `back` is the flow the other way.
    fn carried_by(&self, forward: &Flow, back: &Flow, outline: &[f32]) -> Carried {
        let (w, h) = (self.video.frames[0].width, self.video.frames[0].height);
        let before = Gray { width: w, height: h, values: outline.to_vec() };
        let mut distance = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                let v = back.vectors[y * w + x];
                distance.push(before.sample(x as f32 + v[0], y as f32 + v[1]));
            }
        }
        let half = HALF_TRUST * self.scale;
        let trusted = |(e, v): (f32, &[f32; 2])| {
            let error = e / (half + 0.05 * v[0].hypot(v[1]));
            1.0 / (1.0 + error * error)
        };
        let trust = consistency(back, forward).into_iter().zip(&back.vectors).map(trusted).collect();
        Carried { distance, trust }
    }

    /// Pull of the carried outline.
    fn prior(&self, carried: &Carried, i: usize) -> f32 {
        PRIOR * carried.trust[i] * (carried.distance[i] / (PRIOR_REACH * self.scale)).clamp(-1.0, 1.0)
    }

    fn on_plain(&self, start: Plain, mut outline: Vec<f32>) -> MaskCue {
        let w = self.video.frames[0].width;
        let h = self.video.frames[0].height;
        let (weak, strong) = (start.weak, self.options.threshold);
        let one = |t: usize, carried: &Carried| {
            let frame = &self.video.frames[t];
            let difference = Difference::new(frame, t, &start.background);
            let pull: Vec<f32> =
                (0..w * h).map(|i| unlike_plain(difference.color[i], weak, strong) + self.prior(carried, i)).collect();
            let label = cut(&pull, &carried.distance, w, CERTAIN * self.scale, CONTRAST, |i, j| contrast(frame, i, j));
            let kept = kept_regions(&label, w, h, self.options);
            let lean = |i: usize| carried.trust[i] * (carried.distance[i] / self.scale).clamp(-LEAN_LIMIT, LEAN_LIMIT);
            let coverage = soft_edge(&kept, &difference, w, self.options, lean);
            let mut outline = signed_distance(&coverage.iter().map(|&c| c >= 128).collect::<Vec<_>>(), w);
            // Trimming eats into edges that fade, a little every frame: what is carried on lies between both outlines.
            let untrimmed = signed_distance(&kept, w);
            outline.iter_mut().zip(&untrimmed).for_each(|(d, u)| *d += UNTRIMMED_SHARE * (u - *d));
            (Mask { width: w, height: h, coverage }, outline)
        };
        let mut masks: Vec<Mask> = Vec::new();
        for t in 0..self.video.frames.len() {
            let (mask, next) = one(t, &self.carried(t, &outline));
            outline = next;
            masks.push(mask);
            if t == 1 {
                // Frame 0 again, from the outline of frame 1: edges of all frames are then biased alike, and what compares
                // frame 0 with the silhouette it began from can take that out.
                let (forward, back) = &self.flows[0];
                masks[0] = one(0, &self.carried_by(back, forward, &outline)).0;
            }
        }
        let confidence = start.confidence();
        MaskCue { masks, background: start.background, confidence }
    }

    fn on_clutter(&self, start: Plain, mut outline: Vec<f32>) -> MaskCue {
        let (w, h) = (self.video.frames[0].width, self.video.frames[0].height);
        let mut plate = Plate::empty(w, h);
        let mut colors = Colors::empty();
        let (mut masks, mut confidence, mut plates) = (Vec::new(), Vec::new(), Vec::new());
        for (t, frame) in self.video.frames.iter().enumerate() {
            let carried = self.carried(t, &outline);
            let margin = MARGIN * self.scale;
            if t == 0 {
                plate.learn(frame, |i| outline[i] < -margin);
                colors.learn(frame, |i| (outline[i].abs() > margin).then_some(outline[i] > 0.0));
            } else {
                plate.follow(&self.flows[t - 1].1, |i| carried.distance[i] < -CLEAR * self.scale);
            }
            let noise = noise(frame, &plate, |i| carried.distance[i] < -CLEAR * self.scale);
            let ratios = colors.log_ratios();
            let pull: Vec<f32> = (0..w * h)
                .map(|i| {
                    let color = COLOR * Colors::look_up(&ratios, frame.rgb[i]).clamp(-COLOR_LIMIT, COLOR_LIMIT);
                    unlike_plate(frame, &plate, noise, i) + color + self.prior(&carried, i)
                })
                .collect();
            let edge = |i: usize, j: usize| (contrast(frame, i, j) - plate_contrast(&plate, i, j)).max(0.0);
            let label = cut(&pull, &carried.distance, w, CERTAIN * self.scale, clutter_contrast(frame), edge);
            let kept = touching(&label, &carried.distance, w);
            let coverage = feathered(&kept, w);
            outline = signed_distance(&kept, w);
            plate.learn(frame, |i| outline[i] < -margin);
            colors.learn(frame, |i| (outline[i].abs() > margin).then_some(outline[i] > 0.0));
            masks.push(Mask { width: w, height: h, coverage });
            confidence.push(1.0 / (1.0 + (noise / HALF_CONFIDENCE).powi(2)));
            plates.push(plate.picture());
        }
        let mut background = start.background;
        background.plates = plates;
        MaskCue { masks, background, confidence }
    }
}

/// Pixels nearer to the outline teach nothing [px at 512 rows].
const MARGIN: f32 = 3.0;
/// Weight and limit of colour ratios.
const COLOR: f32 = 0.7;
const COLOR_LIMIT: f32 = 2.0;
/// Noise of the plate at which confidence has fallen to a half [levels].
const HALF_CONFIDENCE: f32 = 12.0;
/// Shift of the background that passes for noise [px].
const PLATE_SHIFT: f32 = 0.3;
/// Pull of the plain background's own colour.
const LIKE_BACKGROUND: f32 = 4.0;
/// Distance to the carried outline beyond which it says no more about the edge [px at 512 rows].
const LEAN_LIMIT: f32 = 2.0;
/// Differences below this share of the upper threshold speak for a plain background, however little noise it has: what
/// compression leaves beside the object is as strong.
const NEUTRAL: f32 = 0.45;
/// Where between the trimmed outline (0) and the cut's (1) the one lies that is carried on.
const UNTRIMMED_SHARE: f32 = 0.7;
/// Noise of the plate at which it is half trusted [levels].
const HALF_PLATE: f32 = 10.0;

/// −4 on the background's colour, 0 at the lower threshold, 4 at the upper one.
fn unlike_plain(difference: f32, weak: f32, strong: f32) -> f32 {
    let weak = weak.max(NEUTRAL * strong);
    if difference < weak {
        LIKE_BACKGROUND * (difference / weak - 1.0)
    } else {
        (4.0 * (difference - weak) / (strong - weak).max(1.0)).min(4.0)
    }
}

fn unlike_plate(frame: &Image, plate: &Plate, noise: f32, i: usize) -> f32 {
    let Some(expected) = plate.at(i) else { return 0.0 };
    let difference = (0..3).map(|c| (f32::from(frame.rgb[i][c]) - expected[c]).abs()).fold(0.0, f32::max);
    let spread = noise.hypot(PLATE_SHIFT * plate.slope(i));
    let trust = 1.0 / (1.0 + (spread / HALF_PLATE).powi(2));
    trust * ((0.5 * (difference / spread).powi(2)).min(8.0) - 3.0)
}

/// Robust spread of the plate where the frame shows background [levels].
fn noise(frame: &Image, plate: &Plate, outside: impl Fn(usize) -> bool) -> f32 {
    let of = |i: usize| {
        let expected = plate.at(i)?;
        Some((0..3).map(|c| (f32::from(frame.rgb[i][c]) - expected[c]).abs()).fold(0.0, f32::max))
    };
    let mut spread: Vec<f32> = (0..frame.rgb.len()).step_by(7).filter(|&i| outside(i)).filter_map(of).collect();
    let middle = spread.len() / 2;
    if spread.is_empty() { 255.0 } else { (1.4826 * *spread.select_nth_unstable_by(middle, f32::total_cmp).1).max(2.0) }
}

/// Largest channel difference of two pixels [levels].
fn contrast(frame: &Image, i: usize, j: usize) -> f32 {
    let (a, b) = (frame.rgb[i], frame.rgb[j]);
    f32::from((0..3).map(|c| a[c].abs_diff(b[c])).max().unwrap_or(0))
}

fn plate_contrast(plate: &Plate, i: usize, j: usize) -> f32 {
    let Some((a, b)) = plate.at(i).zip(plate.at(j)) else { return 0.0 };
    (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max)
}

/// Scale of contrast: that of the picture itself (root mean square), as in GrabCut.
fn clutter_contrast(frame: &Image) -> f32 {
    let pairs = || (0..frame.rgb.len() - 1).step_by(5);
    let sum: f32 = pairs().map(|i| contrast(frame, i, i + 1).powi(2)).sum();
    (sum / pairs().count().max(1) as f32).sqrt().clamp(CONTRAST, 30.0)
}

/// Regions that overlap the carried outline, with pinholes closed.
fn touching(label: &[bool], distance: &[f32], w: usize) -> Vec<bool> {
    let h = label.len() / w;
    let mut kept = vec![false; label.len()];
    for region in regions(label, w) {
        if region.pixels.iter().any(|&i| distance[i as usize] > 0.0) {
            region.pixels.iter().for_each(|&i| kept[i as usize] = true);
        }
    }
    let gaps: Vec<bool> = kept.iter().map(|k| !k).collect();
    for gap in regions(&gaps, w).iter().filter(|g| !g.touches_border(w, h) && g.pixels.len() < 12) {
        gap.pixels.iter().for_each(|&i| kept[i as usize] = true);
    }
    kept
}

/// The labels of least energy. Pixels deeper than `certain` in an area where `pull` and `distance` agree keep their label.
fn cut(
    pull: &[f32],
    distance: &[f32],
    w: usize,
    certain: f32,
    scale: f32,
    contrast: impl Fn(usize, usize) -> f32,
) -> Vec<bool> {
    let n = pull.len();
    let agreed = |sign: f32| -> Vec<f32> {
        depth(&(0..n).map(|i| sign * pull[i] > 1.0 && sign * distance[i] > certain).collect::<Vec<_>>(), w)
    };
    let (inside, outside) = (agreed(1.0), agreed(-1.0));
    const CERTAIN_INSIDE: u32 = u32::MAX;
    const CERTAIN_OUTSIDE: u32 = u32::MAX - 1;
    let mut node = Vec::with_capacity(n);
    let mut terminal: Vec<i32> = Vec::new();
    for i in 0..n {
        node.push(if inside[i] > certain {
            CERTAIN_INSIDE
        } else if outside[i] > certain {
            CERTAIN_OUTSIDE
        } else {
            terminal.push((UNIT * pull[i]) as i32);
            terminal.len() as u32 - 1
        });
    }
    let mut edges = Vec::with_capacity(4 * terminal.len());
    let falloff = -0.5 / (scale * scale);
    for i in 0..n {
        let x = i % w;
        let mut connect = |j: usize, length: f32| {
            let certain = [node[i], node[j]].map(|k| k >= CERTAIN_OUTSIDE);
            if certain[0] && certain[1] {
                return;
            }
            let d = contrast(i, j);
            let capacity = (UNIT * OUTLINE / length * (falloff * d * d).exp()) as i32;
            match certain {
                [false, false] => edges.push((node[i], node[j], capacity)),
                [fixed, _] => {
                    let (known, free) = if fixed { (node[i], node[j]) } else { (node[j], node[i]) };
                    terminal[free as usize] += if known == CERTAIN_INSIDE { capacity } else { -capacity };
                }
            }
        };
        let below = i + w < n;
        if x + 1 < w {
            connect(i + 1, 1.0);
        }
        if below {
            connect(i + w, 1.0);
        }
        if below && x + 1 < w {
            connect(i + w + 1, std::f32::consts::SQRT_2);
        }
        if below && x > 0 {
            connect(i + w - 1, std::f32::consts::SQRT_2);
        }
    }
    let inside = Graph::new(terminal, &edges).source_side();
    node.into_iter().map(|k| k == CERTAIN_INSIDE || (k != CERTAIN_OUTSIDE && inside[k as usize])).collect()
}

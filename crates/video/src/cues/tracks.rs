//! Point tracks by chained optical flow with drift correction.
//!
//! A point moves by the flow to the next frame, is dropped where going back does not return it, and is then matched
//! against a patch from the frame it was taken in (inverse compositional Lucas–Kanade with mean removed), which stops the
//! chain from drifting. Points are taken on the object in frame 0 and again wherever later frames are thinly covered;
//! every point is followed both forwards and backwards.

use crate::flow::{Flow, FlowOptions, Gray, consistency, neighbours};
use animimic_scene::{Mask, Tracks, Video};
use rayon::prelude::*;

/// Settings of [`tracks`].
#[derive(Clone, Debug)]
pub struct TrackOptions {
    /// Points taken in frame 0, about.
    pub points: usize,
    /// Points in all, at most.
    pub max_points: usize,
    /// Frames between looks for thin coverage.
    pub resample_every: usize,
    /// Largest forward–backward error that a point survives [px], plus a twentieth of its step.
    pub max_inconsistency: f32,
    /// Optical flow settings.
    pub flow: FlowOptions,
}

impl Default for TrackOptions {
    fn default() -> Self {
        Self { points: 700, max_points: 1500, resample_every: 6, max_inconsistency: 1.0, flow: FlowOptions::default() }
    }
}

/// Half the side of the patch that corrects drift [px].
const RADIUS: i32 = 5;
const SIDE: usize = 2 * RADIUS as usize + 1;
const STEPS: usize = 6;
/// A correction beyond this is not trusted [px].
const MAX_CORRECTION: f32 = 1.5;
/// Correlation with the template above which its correction is taken …
const GOOD_MATCH: f32 = 0.9;
/// … and below which the template is taken anew from the current frame.
const STALE_MATCH: f32 = 0.75;
/// Smaller eigenvalue of the mean structure tensor at which confidence is a half [levels²/px²].
const HALF_TEXTURE: f32 = 2.0;
/// Points this near to the silhouette slide along it [px].
const EDGE: f32 = 2.5;

/// Tracks points on the object. `masks`: one per frame (empty: the whole picture is object).
///
/// Confidence is 0 where a point is lost, else the product of flow consistency, texture and distance to the silhouette.
pub fn tracks(video: &Video, masks: &[Mask], options: &TrackOptions) -> Tracks {
    let n = video.frames.len();
    if n == 0 {
        return Tracks::default();
    }
    let scene = Scene::new(video, masks, options);
    let area = scene.object_area(0).max(1) as f64;
    let spacing = (area / options.points.max(1) as f64).sqrt().clamp(3.0, 40.0) as usize;
    let mut paths: Vec<Path> = Vec::new();
    for query in (0..n).step_by(options.resample_every.max(1)) {
        // What is left is spread over the looks to come, so that late frames are covered too.
        let looks = (n - query).div_ceil(options.resample_every.max(1));
        let left = options.max_points.saturating_sub(paths.len());
        let room = if query == 0 { left } else { left.div_ceil(looks) };
        let seeds: Vec<[f32; 2]> = scene.seeds(query, spacing, &paths).into_iter().take(room).collect();
        paths.par_extend(seeds.into_par_iter().map(|p| scene.follow(p, query, options)));
    }
    let mut out = Tracks { query_frame: paths.iter().map(|p| p.query as u32).collect(), ..Tracks::default() };
    for t in 0..n {
        out.pixels.push(paths.iter().map(|p| p.pixels[t]).collect());
        out.confidence.push(paths.iter().map(|p| p.confidence[t]).collect());
    }
    out
}

/// One point through time.
struct Path {
    query: usize,
    pixels: Vec<[f32; 2]>,
    confidence: Vec<f32>,
}

/// What all points need.
struct Scene {
    grays: Vec<Gray>,
    /// (t → t + 1, t + 1 → t).
    flows: Vec<(Flow, Flow)>,
    inconsistency: Vec<(Flow1, Flow1)>,
    /// Distance to the outside of the object \[frame\].
    depth: Vec<Vec<f32>>,
}

/// Forward–backward error per pixel.
type Flow1 = Vec<f32>;

impl Scene {
    fn new(video: &Video, masks: &[Mask], options: &TrackOptions) -> Self {
        let grays: Vec<Gray> = video.frames.par_iter().map(Gray::from_image).collect();
        let flows = neighbours(&video.frames, &options.flow);
        let inconsistency = flows.par_iter().map(|(f, b)| (consistency(f, b), consistency(b, f))).collect();
        let all = vec![f32::MAX; grays[0].values.len()];
        let depth = (0..grays.len())
            .into_par_iter()
            .map(|t| match masks.get(t) {
                Some(m) => super::regions::depth(&m.coverage.iter().map(|&c| c >= 128).collect::<Vec<_>>(), m.width),
                None => all.clone(),
            })
            .collect();
        Self { grays, flows, inconsistency, depth }
    }

    fn object_area(&self, t: usize) -> usize {
        self.depth[t].iter().filter(|&&d| d > 0.0).count()
    }

    /// Pixel that holds a position; `None` outside the picture.
    fn pixel(&self, p: [f32; 2]) -> Option<usize> {
        let (w, h) = (self.grays[0].width, self.grays[0].height);
        let inside = p[0] >= 0.0 && p[1] >= 0.0 && p[0] < w as f32 && p[1] < h as f32;
        inside.then(|| p[1] as usize * w + p[0] as usize)
    }

    /// The best textured pixel of every grid cell on the object that no track covers.
    fn seeds(&self, t: usize, spacing: usize, paths: &[Path]) -> Vec<[f32; 2]> {
        let (w, h) = (self.grays[t].width, self.grays[t].height);
        let columns = w.div_ceil(spacing);
        let mut covered = vec![false; columns * h.div_ceil(spacing)];
        for path in paths.iter().filter(|p| p.confidence[t] > 0.0) {
            let p = path.pixels[t];
            // A track also covers the cell that it is about to leave for.
            for dx in [-0.25, 0.25] {
                for dy in [-0.25, 0.25] {
                    let x = ((p[0] / spacing as f32 + dx).max(0.0) as usize).min(columns - 1);
                    let y = (p[1] / spacing as f32 + dy).max(0.0) as usize;
                    if let Some(c) = covered.get_mut(y * columns + x) {
                        *c = true;
                    }
                }
            }
        }
        let texture = texture(&self.grays[t]);
        let mut seeds = Vec::new();
        for (cell, _) in covered.iter().enumerate().filter(|(_, c)| !**c) {
            let (x0, y0) = (cell % columns * spacing, cell / columns * spacing);
            let mut best: Option<(f32, usize, usize)> = None;
            for y in y0..(y0 + spacing).min(h) {
                for x in x0..(x0 + spacing).min(w) {
                    let d = self.depth[t][y * w + x];
                    if d <= 0.0 {
                        continue;
                    }
                    let score = texture[y * w + x] * if d <= EDGE { 0.01 } else { 1.0 };
                    if best.is_none_or(|b| score > b.0) {
                        best = Some((score, x, y));
                    }
                }
            }
            seeds.extend(best.map(|(_, x, y)| [x as f32 + 0.5, y as f32 + 0.5]));
        }
        seeds
    }

    fn follow(&self, start: [f32; 2], query: usize, options: &TrackOptions) -> Path {
        let n = self.grays.len();
        let mut path = Path { query, pixels: vec![start; n], confidence: vec![0.0; n] };
        path.confidence[query] = self.confidence_at(start, query, 0.0);
        self.walk(&mut path, (query + 1..n).collect(), options, true);
        self.walk(&mut path, (0..query).rev().collect(), options, false);
        path
    }

    fn walk(&self, path: &mut Path, frames: Vec<usize>, options: &TrackOptions, forwards: bool) {
        let mut p = path.pixels[path.query];
        let mut template = Template::new(&self.grays[path.query], p);
        let mut lost = false;
        for t in frames {
            if !lost {
                match self.step(p, t, options, forwards) {
                    Some((q, error)) => {
                        p = template.as_ref().map_or(q, |patch| patch.corrected(&self.grays[t], q));
                        if template.as_ref().is_some_and(|patch| patch.correlation(&self.grays[t], p) < STALE_MATCH) {
                            template = Template::new(&self.grays[t], p);
                        }
                        path.confidence[t] = self.confidence_at(p, t, error);
                    }
                    None => lost = true,
                }
            }
            path.pixels[t] = p;
        }
    }

    /// One frame on (to frame `t`): the new position and the forward–backward error; `None` when lost.
    fn step(&self, p: [f32; 2], t: usize, options: &TrackOptions, forwards: bool) -> Option<([f32; 2], f32)> {
        let i = self.pixel(p)?;
        let (flow, error) = if forwards {
            (&self.flows[t - 1].0, self.inconsistency[t - 1].0[i])
        } else {
            (&self.flows[t].1, self.inconsistency[t].1[i])
        };
        let v = flow.at(p);
        if error > options.max_inconsistency + 0.05 * v[0].hypot(v[1]) {
            return None;
        }
        let q = [p[0] + v[0], p[1] + v[1]];
        let j = self.pixel(q)?;
        (self.depth[t][j] > 0.0).then_some((q, error))
    }

    fn confidence_at(&self, p: [f32; 2], t: usize, error: f32) -> f32 {
        let Some(i) = self.pixel(p) else { return 0.0 };
        let texture = texture_at(&self.grays[t], p);
        let edge = if self.depth[t][i] <= EDGE { 0.3 } else { 1.0 };
        let c = edge * texture / (texture + HALF_TEXTURE) / (1.0 + (2.0 * error).powi(2));
        c.clamp(0.01, 1.0)
    }
}

/// Smaller eigenvalue of the structure tensor, mean over 7×7 pixels [levels²/px²].
fn texture_at(image: &Gray, p: [f32; 2]) -> f32 {
    let (x, y) = (p[0] - 0.5, p[1] - 0.5);
    let (mut xx, mut xy, mut yy) = (0.0f32, 0.0f32, 0.0f32);
    for dy in -3..=3 {
        for dx in -3..=3 {
            let (u, v) = (x + dx as f32, y + dy as f32);
            let gx = 0.5 * (image.sample(u + 1.0, v) - image.sample(u - 1.0, v));
            let gy = 0.5 * (image.sample(u, v + 1.0) - image.sample(u, v - 1.0));
            xx += gx * gx;
            xy += gx * gy;
            yy += gy * gy;
        }
    }
    smaller_eigenvalue(xx / 49.0, xy / 49.0, yy / 49.0)
}

fn smaller_eigenvalue(xx: f32, xy: f32, yy: f32) -> f32 {
    0.5 * (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt())
}

/// [`texture_at`] for all pixels, by sums over rows and columns.
fn texture(image: &Gray) -> Vec<f32> {
    let (w, h) = (image.width, image.height);
    let (gx, gy) = image.gradients();
    let window = |values: Vec<f32>| {
        let mut rows = vec![0.0f32; w * h];
        for y in 0..h {
            for x in 0..w {
                rows[y * w + x] = values[y * w + x.saturating_sub(3)..y * w + (x + 4).min(w)].iter().sum();
            }
        }
        let mut out = vec![0.0f32; w * h];
        for y in 0..h {
            for v in y.saturating_sub(3)..(y + 4).min(h) {
                for x in 0..w {
                    out[y * w + x] += rows[v * w + x] / 49.0;
                }
            }
        }
        out
    };
    let product = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(p, q)| p * q).collect::<Vec<f32>>();
    let (xx, xy, yy) = (window(product(&gx, &gx)), window(product(&gx, &gy)), window(product(&gy, &gy)));
    (0..w * h).map(|i| smaller_eigenvalue(xx[i], xy[i], yy[i])).collect()
}

/// The look of a point's neighbourhood in the frame it was taken from, mean removed.
struct Template {
    values: Vec<f32>,
    norm: f32,
    gradients: Vec<[f32; 2]>,
    inverse: [f32; 3],
}

fn patch(image: &Gray, p: [f32; 2]) -> (Vec<f32>, f32) {
    let mut values = Vec::with_capacity(SIDE * SIDE);
    for dy in -RADIUS..=RADIUS {
        for dx in -RADIUS..=RADIUS {
            values.push(image.sample(p[0] - 0.5 + dx as f32, p[1] - 0.5 + dy as f32));
        }
    }
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    values.iter_mut().for_each(|v| *v -= mean);
    let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    (values, norm)
}

impl Template {
    /// `None` where there is too little texture to match.
    fn new(image: &Gray, p: [f32; 2]) -> Option<Self> {
        let (values, norm) = patch(image, p);
        let mut gradients = Vec::with_capacity(values.len());
        let (mut xx, mut xy, mut yy) = (0.0f32, 0.0f32, 0.0f32);
        for dy in -RADIUS..=RADIUS {
            for dx in -RADIUS..=RADIUS {
                let (x, y) = (p[0] - 0.5 + dx as f32, p[1] - 0.5 + dy as f32);
                let gx = 0.5 * (image.sample(x + 1.0, y) - image.sample(x - 1.0, y));
                let gy = 0.5 * (image.sample(x, y + 1.0) - image.sample(x, y - 1.0));
                xx += gx * gx;
                xy += gx * gy;
                yy += gy * gy;
                gradients.push([gx, gy]);
            }
        }
        let area = (SIDE * SIDE) as f32;
        if smaller_eigenvalue(xx / area, xy / area, yy / area) < HALF_TEXTURE {
            return None;
        }
        let determinant = xx * yy - xy * xy;
        Some(Self { values, norm, gradients, inverse: [yy / determinant, -xy / determinant, xx / determinant] })
    }

    fn correlation(&self, image: &Gray, p: [f32; 2]) -> f32 {
        let (values, norm) = patch(image, p);
        let dot: f32 = values.iter().zip(&self.values).map(|(a, b)| a * b).sum();
        dot / (norm * self.norm).max(1e-6)
    }

    /// `start`, moved to where the template fits best; unchanged when the fit is poor or far.
    fn corrected(&self, image: &Gray, start: [f32; 2]) -> [f32; 2] {
        let mut p = start;
        for _ in 0..STEPS {
            let (values, _) = patch(image, p);
            let (mut bx, mut by) = (0.0f32, 0.0f32);
            for ((v, t), g) in values.iter().zip(&self.values).zip(&self.gradients) {
                bx += (v - t) * g[0];
                by += (v - t) * g[1];
            }
            let step = [self.inverse[0] * bx + self.inverse[1] * by, self.inverse[1] * bx + self.inverse[2] * by];
            p = [p[0] - step[0], p[1] - step[1]];
            if (p[0] - start[0]).hypot(p[1] - start[1]) > MAX_CORRECTION {
                return start;
            }
            if step[0].abs().max(step[1].abs()) < 0.01 {
                break;
            }
        }
        let better = self.correlation(image, p);
        if better > GOOD_MATCH && better >= self.correlation(image, start) { p } else { start }
    }
}

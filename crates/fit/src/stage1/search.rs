//! Limb search: when a frame still looks wrong after the local solve, limbs are swung over a grid of angles and the pose
//! that looks most like the frame is taken as a new start.
//!
//! Local correspondences cannot follow a thin leg that moves farther than its own width between two frames, or that comes
//! out from behind another. A search over a few angles per limb, scored by analysis and synthesis on small pictures, can.

use super::correspond::Frame;
use super::layers::Layers;
use super::sight::{Sight, Studio};
use super::subject::Subject;
use animimic_math::so3;
use animimic_rig::FramePose;
use animimic_rig::limbs::Limb;
use animimic_scene::{Camera, Image, Mask};
use glam::DVec3;
use rayon::prelude::*;

/// Angles tried for the first and second lever of a limb [rad].
const ANGLES_RAD: [&[f64]; 2] = [&[-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9], &[-0.8, -0.4, 0.0, 0.4, 0.8]];
/// A swung pose must look better by this factor to be followed.
const CLEARLY: f64 = 0.97;
/// Factors on the angles, sweep by sweep.
const SWEEPS: [f64; 2] = [1.0, 0.4];
/// Small pictures have this height [px].
const SMALL_HEIGHT: usize = 128;
/// Colour differences above this say no more than "wrong".
const COLOR_CAP: f64 = 0.3;
/// Added where only one of rendering and frame shows the object.
const SILHOUETTE_PENALTY: f64 = 0.2;
/// Cost of an angle [1/rad²], so that limbs do not move without reason.
const ANGLE_COST: f64 = 2e-4;

/// How unlike a frame a drawing looks: mean colour difference over the union of rendered and observed object, in [0, 1].
pub fn mismatch(sight: &Sight, image: &Image, mask: &Mask) -> f64 {
    unlike(image, mask, &sight.image, |p| sight.raster.covered(p).then(|| sight.image.rgb[p]))
}

/// The same for a picture whose pixels show the model's colour, or none and `background`.
fn unlike(image: &Image, mask: &Mask, background: &Image, color: impl Fn(usize) -> Option<[u8; 3]>) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for p in 0..image.rgb.len() {
        let (drawn, seen) = (color(p), mask.coverage[p] >= 128);
        if drawn.is_some() || seen {
            let (a, b) = (drawn.unwrap_or(background.rgb[p]), image.rgb[p]);
            let d: f64 = (0..3).map(|c| (f64::from(a[c]) - f64::from(b[c])).abs()).sum::<f64>() / 765.0;
            sum += d.min(COLOR_CAP) + if drawn.is_some() != seen { SILHOUETTE_PENALTY } else { 0.0 };
            count += 1;
        }
    }
    sum / count.max(1) as f64
}

/// A frame reduced for quick scoring.
pub struct Small {
    camera: Camera,
    image: Image,
    mask: Mask,
    background: Image,
}

impl Small {
    /// Averages a frame down.
    pub fn new(frame: &Frame, camera: &Camera) -> Self {
        let factor = (frame.image.height / SMALL_HEIGHT).max(1);
        let (w, h) = (frame.image.width / factor, frame.image.height / factor);
        let exact = camera.resized((w * factor) as u32, (h * factor) as u32);
        let camera = Camera { fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy, ..exact };
        let coverage = (0..w * h)
            .map(|i| {
                let sum: usize = block(i, w, factor, frame.mask.width).map(|p| frame.mask.coverage[p] as usize).sum();
                (sum / (factor * factor)) as u8
            })
            .collect();
        Self {
            camera: camera.resized(w as u32, h as u32),
            image: averaged(frame.image, w, h, factor),
            mask: Mask { width: w, height: h, coverage },
            background: averaged(frame.background, w, h, factor),
        }
    }

    /// How unlike the reduced frame poses look, in [0, 1], of which the limb of `layers` is in another way than in `pose`.
    fn scores<'a>(
        &'a self,
        subject: &'a Subject,
        studio: &'a Studio,
        layers: &'a Layers,
        pose: &FramePose,
    ) -> impl Fn(&FramePose) -> f64 + Sync + 'a {
        let studio = Studio { camera: &self.camera, ..*studio };
        let still = layers.still(subject, &studio, &self.background, &subject.posed(pose));
        move |pose| {
            let moving = layers.moving(subject, &studio, &self.background, &subject.posed(pose));
            unlike(&self.image, &self.mask, &self.background, |p| layers.color(p, &moving, &still))
        }
    }

    /// How unlike the reduced frame a pose looks, in [0, 1].
    pub fn score(&self, subject: &Subject, studio: &Studio, pose: &FramePose) -> f64 {
        let studio = Studio { camera: &self.camera, ..*studio };
        mismatch(&Sight::draw(subject, &studio, &self.background, pose), &self.image, &self.mask)
    }
}

fn block(i: usize, w: usize, factor: usize, source_width: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % w * factor, i / w * factor);
    (y..y + factor).flat_map(move |r| (x..x + factor).map(move |c| r * source_width + c))
}

fn averaged(image: &Image, w: usize, h: usize, factor: usize) -> Image {
    let count = factor * factor;
    let rgb = (0..w * h)
        .map(|i| {
            let mut sum = [0usize; 3];
            for p in block(i, w, factor, image.width) {
                (0..3).for_each(|c| sum[c] += image.rgb[p][c] as usize);
            }
            sum.map(|s| (s / count) as u8)
        })
        .collect();
    Image { width: w, height: h, rgb }
}

/// The best pose found by swinging one limb after the other, in the limbs' order or backwards; `None` where none looks
/// clearly better than `start` on the small picture.
pub fn swing_limbs(
    subject: &Subject,
    studio: &Studio,
    small: &Small,
    start: &FramePose,
    backwards: bool,
) -> Option<FramePose> {
    let view_axis = studio.camera.view_from_world.matrix3.row(2);
    let mut best = start.clone();
    let before = small.score(subject, studio, &best);
    let mut score = before;
    let count = subject.limbs.len();
    let mut moved = vec![true; count];
    for scale in SWEEPS {
        for k in 0..count {
            // What a sweep left in place the finer one leaves too.
            if !moved[k] {
                continue;
            }
            let which = if backwards { count - 1 - k } else { k };
            let limb = &subject.limbs[which];
            let candidates = candidates(limb, scale);
            let look = small.scores(subject, studio, subject.layers(which), &best);
            let scores: Vec<f64> = candidates
                .par_iter()
                .map(|angles| {
                    let cost: f64 = angles.iter().map(|a| ANGLE_COST * a * a).sum();
                    look(&swung(subject, &best, limb, angles, view_axis)) + cost
                })
                .collect();
            let Some(c) = (0..scores.len()).min_by(|&a, &b| scores[a].total_cmp(&scores[b])) else { continue };
            moved[k] = scores[c] < score;
            if moved[k] {
                let pose = swung(subject, &best, limb, &candidates[c], view_axis);
                score = look(&pose);
                best = pose;
            }
        }
    }
    (score < before * CLEARLY).then_some(best)
}

/// All combinations of angles for a limb's first levers.
fn candidates(limb: &Limb, scale: f64) -> Vec<Vec<f64>> {
    let mut all: Vec<Vec<f64>> = vec![Vec::new()];
    for angles in &ANGLES_RAD[..limb.levers.len().min(ANGLES_RAD.len())] {
        all = all
            .iter()
            .flat_map(|c| angles.iter().map(move |a| c.iter().copied().chain([scale * a]).collect()))
            .collect();
    }
    all
}

fn swung(subject: &Subject, pose: &FramePose, limb: &Limb, angles: &[f64], view_axis: DVec3) -> FramePose {
    let mut moved = pose.clone();
    for (&j, &angle) in limb.levers.iter().zip(angles) {
        let axis = limb.hinge.unwrap_or_else(|| subject.posed(&moved).transforms[j].matrix3.transpose() * view_axis);
        moved.rotations[j] *= so3::exp(axis * angle);
    }
    moved
}

//! The last touch: all terms together with the rendered ones.
//!
//! Correspondences say where points are; colour and silhouette say what is still different. E = (all terms of the last
//! linearisation) + w_rgb L_rgb + w_mask L_mask over all frames, minimised by L-BFGS in the metric of the Levenberg–Marquardt
//! Hessian, which knows how stiff each joint is. Only descent is accepted.

use super::correspond::Frame;
use super::sight::Sight;
use super::solve::{Stage, Strength};
use crate::combined::Combined;
use crate::quasi_newton::{Descent, minimise};
use crate::rendered::{MaskLoss, Model, Observed, RgbLoss, Weighted};
use crate::solver::{linearize, pose_all};
use animimic_math::block_tridiagonal::Factor;
use animimic_render::{Light, solve_exposure};
use animimic_rig::FramePose;
use animimic_scene::Mask;
use glam::DVec2;
use rayon::prelude::*;
use std::sync::atomic::Ordering;

/// Damping of the metric.
const DAMPING: f64 = 1e-2;
/// A step that gains less than this share of the energy is the last of the fit.
pub const SETTLED: f64 = 1e-4;

/// A term's energy after each step.
#[derive(Clone, Debug)]
pub struct Curve {
    /// The term.
    pub name: String,
    /// Energies.
    pub values: Vec<f64>,
}

impl Stage<'_> {
    /// Polishes all frames until a step gains less than the share `settled` of the energy; returns the energy of each term after
    /// each step.
    pub fn polish(&self, poses: &mut Vec<FramePose>, settled: f64) -> Vec<Curve> {
        let s = &self.settings;
        let strength = self.finishing_strength();
        if s.polish_steps == 0 || (s.rgb <= 0.0 && s.mask <= 0.0) {
            return Vec::new();
        }
        let count = poses.len();
        let found = self.correspond_all(poses, 0..count);
        let lights: Vec<Light> = (0..count).into_par_iter().map(|t| self.exposed(&poses[t], t)).collect();
        let observed: Vec<Observed> = self.frames.par_iter().map(|f| observed(f, self.contour_bias_px)).collect();
        let smoothness = self.smoothing(poses, strength.smoothing);
        self.with_problem(count, 0..count, &found, strength, &smoothness, |problem| {
            let posed = pose_all(problem, poses);
            let Some(metric) = linearize(problem, poses, &posed, &(0..count)).factor(DAMPING) else {
                return Vec::new();
            };
            let (rgb, mask) = (RgbLoss::default(), MaskLoss::default());
            let losses = [Weighted { loss: &rgb, weight: s.rgb }, Weighted { loss: &mask, weight: s.mask }];
            let combined = Combined {
                problem,
                model: self.model(),
                flesh: self.flesh.as_ref(),
                losses: &losses,
                observed: &observed,
                lights: &lights,
                metric,
            };
            let Descent { end, history, not_finite } =
                minimise(&combined, std::mem::take(poses), s.polish_steps, settled);
            *poses = end;
            self.not_finite.fetch_add(not_finite, Ordering::Relaxed);
            let names = ["flow", "contour", "tracks", "depth", "priors", "penetration", "smoothness", "rgb", "mask"];
            let curve =
                |(k, name): (usize, &str)| Curve { name: name.into(), values: history.iter().map(|h| h[k]).collect() };
            names.into_iter().enumerate().map(curve).collect()
        })
    }

    /// The factor of the damped Gauss–Newton matrix of all terms at `poses`: a metric for other losses of the same motion;
    /// `None` where it is not positive definite.
    pub fn metric(&self, poses: &[FramePose], strength: Strength) -> Option<Factor> {
        let all = 0..poses.len();
        let found = self.correspond_all(poses, all.clone());
        let smoothness = self.smoothing(poses, strength.smoothing);
        self.with_problem(poses.len(), all.clone(), &found, strength, &smoothness, |problem| {
            linearize(problem, poses, &pose_all(problem, poses), &all).factor(DAMPING)
        })
    }

    /// What rendered losses draw.
    pub fn model(&self) -> Model<'_> {
        Model {
            kinematics: &self.subject.tree.kinematics,
            vertices: &self.subject.vertices,
            surface: &self.subject.surface,
            camera: self.studio.camera,
        }
    }

    /// The light with the exposure of a frame.
    fn exposed(&self, pose: &FramePose, t: usize) -> Light {
        self.exposed_to(&self.draw(pose, t), t)
    }

    /// The same with the model drawn before.
    pub(crate) fn exposed_to(&self, sight: &Sight, t: usize) -> Light {
        let rgb: Vec<[f32; 3]> = sight.image.rgb.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect();
        let (image, mask) = (self.frames[t].image, self.frames[t].mask);
        let gain = solve_exposure(&rgb, &sight.raster, image, Some(mask)).unwrap_or([1.0; 3]);
        self.studio.light.scaled(gain.map(|g| g.clamp(1.0 / MAX_GAIN, MAX_GAIN)))
    }
}

/// Exposure drifts less than this; more is a wrong pose.
const MAX_GAIN: f64 = 1.25;
/// The mask is shifted where its contour is nearer than this [px].
const BAND_PX: f64 = 4.0;

/// A frame with its mask as a rendering in the right place would have it: the observed contour lies `bias_px` outside.
pub(crate) fn observed<'a>(frame: &Frame<'a>, bias_px: f64) -> Observed<'a> {
    let mut mask = Mask {
        width: frame.mask.width,
        height: frame.mask.height,
        coverage: frame.mask.coverage.iter().map(|&c| if c >= 128 { 255 } else { 0 }).collect(),
    };
    let contour = &frame.contour;
    let reach = BAND_PX as isize + 1;
    let (w, h) = (mask.width as isize, mask.height as isize);
    for point in &contour.points {
        let (x0, y0) = (point.x as isize, point.y as isize);
        for y in (y0 - reach).max(0)..(y0 + reach + 1).min(h) {
            for x in (x0 - reach).max(0)..(x0 + reach + 1).min(w) {
                let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let Some(q) = contour.nearest(p).filter(|&q| contour.points[q].distance(p) < BAND_PX) else { continue };
                // Boundary pixels are inside; their edge is half a pixel farther out.
                let depth = contour.normals[q].dot(contour.points[q] - p) + 0.5 - bias_px;
                mask.coverage[(y * w + x) as usize] = (255.0 * (depth + 0.5).clamp(0.0, 1.0)) as u8;
            }
        }
    }
    let area: f64 = mask.coverage.iter().map(|&c| f64::from(c) / 255.0).sum();
    Observed { image: frame.image, background: frame.background, divisor_px: area.max(LEAST_AREA_PX), mask }
}

/// An object smaller than this does not count more for being small [px].
const LEAST_AREA_PX: f64 = 400.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::with_stage;
    use animimic_math::gradcheck::SplitMix64;

    #[test]
    fn the_polish_descends_looks_more_like_the_video_and_gives_the_same_bytes_for_any_number_of_threads() {
        with_stage(|stage, truth| {
            let subject = stage.subject;
            let tree = &subject.tree.kinematics;
            let mut rng = SplitMix64(5);
            let mut near =
                |p: &FramePose| tree.retract(p, &(0..tree.dimension).map(|_| 0.008 * rng.normal()).collect::<Vec<_>>());
            let start: Vec<FramePose> = truth.iter().map(&mut near).collect();
            let with = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
                let mut poses = start.clone();
                let curves = pool.install(|| stage.polish(&mut poses, SETTLED));
                (poses, curves)
            };
            let (one, three) = (with(1), with(3));
            assert_eq!(one.0, three.0);
            let total = |k: usize| -> f64 { one.1.iter().map(|c| c.values[k]).sum() };
            let last = one.1[0].values.len() - 1;
            assert!(last > 0 && (0..last).all(|k| total(k + 1) < total(k)), "every step descends");
            let unlike = |poses: &[FramePose]| -> f64 {
                poses.iter().enumerate().map(|(t, p)| stage.mismatch(p, t)).sum::<f64>() / truth.len() as f64
            };
            let rendered = |k: usize| -> f64 { one.1.iter().rev().take(2).map(|c| c.values[k]).sum() };
            println!(
                "energy {:.1} to {:.1}, rendered part {:.1} to {:.1}",
                total(0),
                total(last),
                rendered(0),
                rendered(last)
            );
            println!("mismatch {:.4} to {:.4}", unlike(&start), unlike(&one.0));
            assert!(rendered(last) < 0.5 * rendered(0));
            assert!(unlike(&one.0) < 0.7 * unlike(&start));
        });
    }

    #[test]
    fn a_mask_is_shifted_by_the_bias_of_its_contour() {
        let inside = |p: usize| (8..24).contains(&(p % 32)) && (8..24).contains(&(p / 32));
        let mask =
            Mask { width: 32, height: 32, coverage: (0..1024).map(|p| if inside(p) { 255 } else { 0 }).collect() };
        let image = animimic_scene::Image::filled(32, 32, [0; 3]);
        let frame = Frame {
            image: &image,
            mask: &mask,
            contour: super::super::contour::Contour::new(&mask),
            background: &image,
        };
        let area = |bias: f64| {
            let seen = observed(&frame, bias);
            seen.mask.coverage.iter().map(|&c| f64::from(c) / 255.0).sum::<f64>()
        };
        println!("{:.1} px, {:.1} px with half a pixel off all round", area(0.0), area(0.5));
        assert!((area(0.0) - 256.0).abs() < 5.0 && (area(0.5) - 225.0).abs() < 6.0);
    }
}

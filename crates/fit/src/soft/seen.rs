//! Evidence from a video: stage 1's own terms, for a surface that no longer follows the skin.
//!
//! The surface is drawn where it is believed to be; dense flow, silhouettes and given tracks say where its points are in every frame
//! (residuals in pixels along known directions). Colour and silhouette are compared through the renderer, with its adjoint.
//! Weights and robust losses are those of stage 1's last solve.

use super::evidence::{Evidence, Residual};
use crate::rendered::{MaskLoss, Observed, RgbLoss, View, Weighted};
use crate::robust::Robust;
use crate::stage1::polish::observed;
use crate::stage1::sight::{Point, Sight};
use crate::stage1::solve::Stage;
use crate::terms::PixelTarget;
use crate::view::project;
use animimic_render::Light;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Independent observations that a frame is worth: residuals of neighbouring pixels and frames err alike.
const INDEPENDENT: f64 = 20.0;
/// Contours are whole pixels: residuals below this are rounding [px].
const CONTOUR_HUBER_PX: f64 = 1.5;

/// What a video says about a surface near where it was drawn.
pub struct Seen<'a> {
    stage: &'a Stage<'a>,
    targets: Vec<Vec<Target>>,
    lights: Vec<Light>,
    observed: Vec<Observed<'a>>,
}

/// A surface point that should project to a pixel, or to a line through it.
struct Target {
    point: Point,
    pixel: DVec2,
    normal: Option<DVec2>,
    weight: f64,
    robust: Robust,
}

impl<'a> Seen<'a> {
    /// Looks for the surfaces \[frame\]\[vertex\] in the frames, outlines within `reach_px`.
    pub fn new(stage: &'a Stage<'a>, surfaces: &[Vec<DVec3>], reach_px: f64) -> Self {
        let rest = stage.subject.tree.kinematics.rest();
        let sights: Vec<Sight> = surfaces
            .par_iter()
            .zip(&stage.frames)
            .map(|(surface, frame)| {
                let posed = stage.subject.posed(&rest);
                Sight::draw_surface(stage.subject, &stage.studio, frame.background, posed, surface.clone())
            })
            .collect();
        for (t, sight) in sights.iter().enumerate().filter(|(t, _)| stage.given.starts_in(*t)) {
            stage.given.anchor(stage.subject, stage.studio.camera, sight, t);
        }
        Self {
            stage,
            targets: sights.par_iter().enumerate().map(|(t, s)| targets(stage, s, t, reach_px)).collect(),
            lights: sights.par_iter().enumerate().map(|(t, s)| stage.exposed_to(s, t)).collect(),
            observed: stage.frames.par_iter().map(|f| observed(f, stage.contour_bias_px)).collect(),
        }
    }

    /// Energy of each frame of surfaces \[frame\]\[vertex\].
    pub fn energies(&self, surfaces: &[Vec<DVec3>]) -> Vec<f64> {
        let one = |(t, x): (usize, &Vec<DVec3>)| -> f64 {
            self.residuals(t, x).iter().map(Residual::energy).sum::<f64>() + self.rendered(t, x, false).0
        };
        surfaces.par_iter().enumerate().map(one).collect()
    }
}

/// How unlike each frame of the video surfaces \[frame\]\[vertex\] are, by stage 1's terms: looked for anew where they are.
pub fn energies(stage: &Stage, surfaces: &[Vec<DVec3>]) -> Vec<f64> {
    Seen::new(stage, surfaces, stage.settings.reach_px.1).energies(surfaces)
}

fn targets(stage: &Stage, sight: &Sight, t: usize, reach_px: f64) -> Vec<Target> {
    let s = &stage.settings;
    let found = stage.correspond_to(sight, t, reach_px);
    let (fine, coarse) = (Robust::Huber(s.final_huber_px), Robust::Huber(s.final_huber_px.max(CONTOUR_HUBER_PX)));
    let kinds: [(&[PixelTarget], f64, Robust); 3] = [
        (&found.flow, s.flow * s.final_flow, fine),
        (&found.contour, s.contour, coarse),
        (&found.tracks, s.tracks, fine),
    ];
    let mut out = Vec::new();
    for (list, weight, robust) in kinds {
        // Mean over the frame's targets: the weights do not depend on how many points were found.
        let scale = weight / list.len().max(100) as f64;
        out.extend(list.iter().map(|p| Target {
            point: found.points[p.anchor as usize],
            pixel: p.pixel,
            normal: p.normal,
            weight: p.weight * scale,
            robust,
        }));
    }
    out
}

impl Evidence for Seen<'_> {
    fn residuals(&self, frame: usize, surface: &[DVec3]) -> Vec<Residual> {
        let mut out = Vec::new();
        for t in self.targets.get(frame).into_iter().flatten() {
            let seen = project(self.stage.studio.camera, t.point.position(surface));
            let off = seen.pixel - t.pixel;
            let mut add = |along: DVec3, value: f64| {
                let corner = |k: usize| (t.point.corners[k], along * t.point.weights[k]);
                out.push(Residual { value, weight: t.weight, robust: t.robust, gradient: [0, 1, 2].map(corner) });
            };
            match t.normal {
                Some(n) => add(seen.du * n.x + seen.dv * n.y, n.dot(off)),
                None => {
                    add(seen.du, off.x);
                    add(seen.dv, off.y);
                }
            }
        }
        out
    }

    fn rendered(&self, frame: usize, surface: &[DVec3], gradient: bool) -> (f64, Vec<DVec3>) {
        let s = &self.stage.settings;
        let Some(seen) = self.observed.get(frame) else { return (0.0, vec![DVec3::ZERO; surface.len()]) };
        let (rgb, mask) = (RgbLoss::default(), MaskLoss::default());
        let losses = [Weighted { loss: &rgb, weight: s.rgb }, Weighted { loss: &mask, weight: s.mask }];
        let view = View { surface: &self.stage.subject.surface, camera: self.stage.studio.camera };
        let (values, forces) = view.evaluate(&losses, seen, &self.lights[frame], surface, gradient);
        (losses.iter().zip(values).map(|(l, v)| l.weight * v).sum(), forces)
    }

    fn observations(&self) -> f64 {
        INDEPENDENT * self.targets.len() as f64
    }
}

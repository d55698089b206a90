//! Draw the model where it is believed to be, see where its points went, move it there: one frame, or all together.

use super::contour::Contour;
use super::correspond::{Correspondences, Flow, FlowAround, Frame, by_contour, by_flow};
use super::flesh::Flesh;
use super::given::Given;
use super::search::mismatch;
use super::settings::Settings;
use super::sight::{Sight, Studio};
use super::subject::Subject;
use crate::robust::Robust;
use crate::schedule::geometric;
use crate::solver::{Options, Problem, Smoothness, solve};
use crate::terms::{Context, Depth, DepthTarget, JointPrior, JointPriors, Penetration, Pixels};
use animimic_rig::{AnchorColumns, FramePose};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Everything stage 1 works with.
pub struct Stage<'a> {
    /// The model.
    pub subject: &'a Subject<'a>,
    /// Camera and light.
    pub studio: Studio<'a>,
    /// Frames with masks and contours.
    pub frames: Vec<Frame<'a>>,
    /// Dense flow between two pictures.
    pub flow: &'a Flow<'a>,
    /// Tracks and depth made elsewhere.
    pub given: Given<'a>,
    /// Constants.
    pub settings: Settings,
    /// How far the masks' contours lie outside the rendered ones where both show the same [px]; see [`contour_bias`].
    pub contour_bias_px: f64,
    /// Mismatch of the rest pose in frame 0: what light, compression and the mask's edge leave of a perfect pose.
    pub usual_mismatch: f64,
    /// Trials so far whose energy was not a number; they were taken back.
    pub not_finite: AtomicUsize,
    /// How the surface is off the skin, where it has soft tissue already.
    pub flesh: Option<Flesh>,
}

impl Stage<'_> {
    /// Draws a pose over the background of a frame.
    pub fn draw(&self, pose: &FramePose, frame: usize) -> Sight {
        let background = self.frames[frame].background;
        let Some(flesh) = &self.flesh else { return Sight::draw(self.subject, &self.studio, background, pose) };
        let posed = self.subject.posed(pose);
        let surface = flesh.anchors(frame).iter().map(|a| a.position(&posed)).collect();
        Sight::draw_surface(self.subject, &self.studio, background, posed, surface)
    }

    /// Draws a pose and finds its correspondences in a frame.
    pub fn correspond(&self, pose: &FramePose, frame: usize, reach_px: f64) -> Correspondences {
        self.correspond_to(&self.draw(pose, frame), frame, reach_px)
    }

    /// Finds the correspondences of a drawing in a frame.
    pub fn correspond_to(&self, sight: &Sight, frame: usize, reach_px: f64) -> Correspondences {
        let mut found = Correspondences::default();
        let (seen, tracked) = (&self.frames[frame], self.given.add_tracks(self.subject, frame, &mut found));
        let (flow, rendered) = rayon::join(
            || if tracked { None } else { FlowAround::new(sight, seen, self.flow) },
            || Contour::new(&sight.raster.mask()),
        );
        by_flow(self.subject, sight, seen, flow, &mut found);
        self.given.add_depth(self.studio.camera, frame, &mut found);
        by_contour(self.subject, (sight, &rendered), seen, reach_px, self.contour_bias_px, &mut found);
        if let Some(flesh) = &self.flesh {
            let vertices = flesh.anchors(frame);
            found.anchors = found.points.iter().map(|p| p.anchor_of(&vertices)).collect();
        }
        found
    }

    /// Solves the frames in `active` for their correspondences (one entry per active frame); other frames stay.
    pub fn solve(
        &self,
        poses: &mut [FramePose],
        active: Range<usize>,
        found: &[Correspondences],
        strength: Strength,
        iterations: usize,
    ) -> Vec<f64> {
        let options = Options { max_iterations: iterations, tolerance: 1e-4, damping: 1e-3 };
        let smoothness = self.smoothing(poses, strength.smoothing);
        self.with_problem(poses.len(), active.clone(), found, strength, &smoothness, |problem| {
            let report = solve(problem, poses, active, &options);
            self.not_finite.fetch_add(report.not_finite, Ordering::Relaxed);
            report.energies
        })
    }

    /// Assembles all terms of the frames in `active` and hands them over.
    pub(super) fn with_problem<R>(
        &self,
        count: usize,
        active: Range<usize>,
        found: &[Correspondences],
        strength: Strength,
        smoothness: &Smoothness,
        work: impl FnOnce(&Problem) -> R,
    ) -> R {
        let s = &self.settings;
        let huber_px = strength.huber_px;
        let kinematics = &self.subject.tree.kinematics;
        let mut anchors = self.subject.balls.anchors.clone();
        let mut flow = Pixels {
            targets: vec![Vec::new(); count],
            robust: Robust::Huber(huber_px),
            weight: s.flow * strength.flow,
        };
        let mut contour =
            Pixels { weight: s.contour, robust: Robust::Huber(huber_px.max(CONTOUR_HUBER_PX)), ..flow.clone() };
        let mut tracks = Pixels { weight: s.tracks, ..flow.clone() };
        let mut depth = Depth {
            targets: vec![Vec::new(); count],
            sigma: self.given.depth_sigma(),
            robust: Robust::Huber(DEPTH_HUBER),
            weight: s.depth,
            affine: true,
            kind: self.given.kind,
        };
        for (t, c) in active.clone().zip(found) {
            let base = anchors.len() as u32;
            anchors.extend(c.anchors.iter().cloned());
            // Mean over the frame's targets: the weights do not depend on how many points were found.
            let mean = |count: usize| 1.0 / count.max(100) as f64;
            let scale = mean(c.depth.len());
            depth.targets[t].extend(c.depth.iter().map(|d| DepthTarget {
                anchor: d.anchor + base,
                weight: d.weight * scale,
                ..*d
            }));
            for (source, target) in [(&c.flow, &mut flow), (&c.contour, &mut contour), (&c.tracks, &mut tracks)] {
                let scale = mean(source.len());
                target.targets[t].extend(source.iter().map(|p| crate::terms::PixelTarget {
                    anchor: p.anchor + base,
                    weight: p.weight * scale,
                    ..*p
                }));
            }
        }
        let columns: Vec<AnchorColumns> = anchors.par_iter().map(|a| a.columns(kinematics)).collect();
        let priors = self.priors(strength);
        let penetration =
            Penetration { pairs: &self.subject.balls.pairs, weight: s.penetration / self.subject.diagonal.powi(2) };
        let problem = Problem {
            context: Context { kinematics, camera: self.studio.camera, anchors: &anchors, columns: &columns },
            terms: vec![&flow, &contour, &tracks, &depth, &priors, &penetration],
            smoothness: Some(smoothness),
        };
        work(&problem)
    }

    /// The smoothness that a strength asks for, at some poses.
    pub(super) fn smoothing(&self, poses: &[FramePose], smoothing: Smoothing) -> Smoothness {
        let own = match smoothing {
            Smoothing::Uniform(factor) => return self.smoothness(factor),
            Smoothing::Lively => self.lively_smoothness(poses),
        };
        own.unwrap_or_else(|| self.smoothness(self.settings.final_smoothness))
    }

    fn smoothness(&self, scale: f64) -> Smoothness {
        let d2 = self.subject.diagonal.powi(2);
        let axis = self.studio.camera.view_from_world.matrix3.row(2);
        Smoothness {
            anchors: self.subject.pseudo.clone(),
            velocity: scale * self.settings.velocity / d2,
            acceleration: scale * self.settings.acceleration / d2,
            basis: Smoothness::stretched_basis(axis, self.settings.view_axis),
        }
    }

    fn priors(&self, strength: Strength) -> JointPriors {
        let s = &self.settings.scaled(strength);
        let kinematics = &self.subject.tree.kinematics;
        let d2 = self.subject.diagonal.powi(2);
        let across = |axis: DVec3, stiffness: f64| {
            let (a, b) = axis.any_orthonormal_pair();
            [a * stiffness.sqrt(), b * stiffness.sqrt()]
        };
        let usual = JointPrior {
            stiffness: s.rest,
            limit_rad: s.limit_rad,
            limit_stiffness: s.limit,
            slide_stiffness: s.slide / d2,
            ..JointPrior::FREE
        };
        let mut all = vec![usual; kinematics.len()];
        for limb in &self.subject.limbs {
            let Some(hinge) = limb.hinge else { continue };
            for (k, &j) in limb.joints.iter().enumerate() {
                all[j].stiff_axes = across(hinge, if k == 0 { s.off_hinge_top } else { s.off_hinge });
            }
        }
        for root in (0..kinematics.len()).filter(|&j| kinematics.parents[j].is_none()) {
            all[root] = JointPrior::FREE;
            if let Some(lateral) = self.subject.lateral {
                all[root].stiff_axes = across(lateral, s.rest);
                all[root].slide_axis = lateral * (s.lateral / d2).sqrt();
            }
        }
        // Frame 0 shows the rest pose: the video began from a picture of it.
        let held = |p: &JointPrior| JointPrior {
            stiffness: p.stiffness + s.first_frame,
            slide_stiffness: p.slide_stiffness + s.first_frame_slide / d2,
            ..*p
        };
        JointPriors { joints: vec![all.iter().map(held).collect(), all] }
    }

    /// Draws and solves one frame in turn, from far to near.
    pub(super) fn settle(&self, poses: &mut [FramePose], t: usize, guesses: f64) {
        for round in 0..self.settings.rounds {
            let u = round as f64 / (self.settings.rounds - 1).max(1) as f64;
            let found = self.correspond(&poses[t], t, geometric(self.settings.reach_px, u));
            let huber_px = geometric(self.settings.huber_px, u);
            let smoothing = Smoothing::Uniform(1.0);
            self.solve(poses, t..t + 1, &[found], Strength { huber_px, priors: 1.0, smoothing, guesses, flow: 1.0 }, 6);
        }
    }

    /// The last pose, or the last pose moved on at the last velocity, whichever looks more like the frame.
    pub(super) fn predict(&self, poses: &[FramePose], t: usize) -> FramePose {
        let last = &poses[poses.len() - 1];
        if poses.len() < 2 {
            return last.clone();
        }
        let kinematics = &self.subject.tree.kinematics;
        let step: Vec<f64> =
            kinematics.difference(&poses[poses.len() - 2], last).iter().map(|v| VELOCITY_KEPT * v).collect();
        let moved = kinematics.retract(last, &step);
        if self.mismatch(&moved, t) < self.mismatch(last, t) { moved } else { last.clone() }
    }

    /// Whether the rig suggests anything that can be left out.
    pub fn guesses_matter(&self) -> bool {
        let s = &self.settings;
        (s.off_hinge > 0.0 && self.subject.limbs.iter().any(|l| l.hinge.is_some()))
            || (s.lateral > 0.0 && self.subject.lateral.is_some())
    }

    /// How unlike a frame a pose looks, in [0, 1].
    pub fn mismatch(&self, pose: &FramePose, t: usize) -> f64 {
        mismatch(&self.draw(pose, t), self.frames[t].image, self.frames[t].mask)
    }

    /// How unlike the video each frame looks, in [0, 1].
    pub fn mismatches(&self, poses: &[FramePose]) -> Vec<f64> {
        poses.par_iter().enumerate().map(|(t, pose)| self.mismatch(pose, t)).collect()
    }

    /// Refines all frames together in one of `batch_rounds` rounds: redraw every frame, solve jointly; round by round the priors
    /// step back behind what is seen. Returns the energies.
    pub fn refine(&self, poses: &mut [FramePose], round: usize, guesses: f64) -> Vec<f64> {
        let u = (round + 1) as f64 / self.settings.batch_rounds as f64;
        self.refine_once(poses, self.strength(u, guesses))
    }

    /// One more round at the final strength, each point as smooth as itself. Returns the energies.
    pub fn finish(&self, poses: &mut [FramePose]) -> Vec<f64> {
        self.refine_once(poses, self.finishing_strength())
    }

    /// One round of drawing every frame and solving all of them.
    pub fn refine_once(&self, poses: &mut [FramePose], strength: Strength) -> Vec<f64> {
        let all = 0..poses.len();
        self.solve(poses, all.clone(), &self.correspond_all(poses, all), strength, 8)
    }

    /// Correspondences of some frames, at the closest reach.
    pub(super) fn correspond_all(&self, poses: &[FramePose], frames: Range<usize>) -> Vec<Correspondences> {
        frames.into_par_iter().map(|t| self.correspond(&poses[t], t, self.settings.reach_px.1)).collect()
    }

    /// Strength at the end of refinement.
    pub(super) fn final_strength(&self) -> Strength {
        self.strength(1.0, self.settings.final_priors)
    }

    /// The same with each point as smooth as itself.
    pub(super) fn finishing_strength(&self) -> Strength {
        Strength { smoothing: Smoothing::Lively, ..self.final_strength() }
    }

    /// Strength at a share `u` of refinement.
    pub fn strength(&self, u: f64, guesses: f64) -> Strength {
        let s = &self.settings;
        Strength {
            huber_px: geometric((s.huber_px.1, s.final_huber_px), u),
            priors: geometric((1.0, s.final_priors), u),
            smoothing: Smoothing::Uniform(geometric((1.0, s.final_smoothness), u)),
            guesses: geometric((guesses, s.final_priors), u),
            flow: geometric((1.0, s.final_flow), u),
        }
    }
}

/// How a solve weighs what is seen.
#[derive(Clone, Copy, Debug)]
pub struct Strength {
    /// Huber threshold of appearance and contour residuals [px].
    pub huber_px: f64,
    /// Factor on the pull towards rest.
    pub priors: f64,
    /// Smoothness over time.
    pub smoothing: Smoothing,
    /// Factor on what is guessed from the rig: hinges, and a root that does not slide sideways.
    pub guesses: f64,
    /// Factor on appearance.
    pub flow: f64,
}

/// How smoothness over time is weighed.
#[derive(Clone, Copy, Debug)]
pub enum Smoothing {
    /// Alike for all points, with a factor.
    Uniform(f64),
    /// Each point against its own liveliness so far.
    Lively,
}

/// Contours are whole pixels: residuals below this are rounding, which only their mean sees through [px].
const CONTOUR_HUBER_PX: f64 = 1.5;
/// Huber threshold of depth residuals [σ].
const DEPTH_HUBER: f64 = 2.0;
/// Share of the last velocity that a prediction keeps.
const VELOCITY_KEPT: f64 = 0.9;

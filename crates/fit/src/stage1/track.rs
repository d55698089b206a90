//! Frame by frame: draw the model where it is believed to be, see where its points went, move it there.

use super::correspond::{Correspondences, Flow, Frame, by_contour, by_flow};
use super::given::Given;
use super::search::{Small, mismatch, swing_limbs};
use super::settings::Settings;
use super::sight::{Sight, Studio};
use super::subject::Subject;
use crate::FitError;
use crate::robust::Robust;
use crate::solver::{Options, Problem, Smoothness, solve};
use crate::terms::{Context, Depth, DepthTarget, JointPrior, JointPriors, Pixels};
use animimic_rig::{AnchorColumns, FramePose};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::{ControlFlow, Range};

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
}

impl Stage<'_> {
    /// Draws a pose over the background of a frame.
    pub fn draw(&self, pose: &FramePose, frame: usize) -> Sight {
        Sight::draw(self.subject, &self.studio, self.frames[frame].background, pose)
    }

    /// Draws a pose and finds its correspondences in a frame.
    pub fn correspond(&self, pose: &FramePose, frame: usize, reach_px: f64) -> Correspondences {
        let sight = self.draw(pose, frame);
        let mut found = Correspondences::default();
        if !self.given.add_tracks(frame, &mut found) {
            by_flow(self.subject, &sight, &self.frames[frame], self.flow, &mut found);
        }
        self.given.add_depth(self.studio.camera, frame, &mut found);
        by_contour(self.subject, &sight, &self.frames[frame], reach_px, self.contour_bias_px, &mut found);
        found
    }

    /// Solves the frames in `active` for their correspondences (one entry per active frame); other frames stay.
    pub fn solve(
        &self,
        poses: &mut [FramePose],
        active: Range<usize>,
        found: &[Correspondences],
        huber_px: f64,
        iterations: usize,
    ) -> Vec<f64> {
        let s = &self.settings;
        let kinematics = &self.subject.tree.kinematics;
        let mut anchors = Vec::new();
        let mut flow =
            Pixels { targets: vec![Vec::new(); poses.len()], robust: Robust::Huber(huber_px), weight: s.flow };
        let mut contour = Pixels { weight: s.contour, ..flow.clone() };
        let mut tracks = Pixels { weight: s.tracks, ..flow.clone() };
        let mut depth = Depth {
            targets: vec![Vec::new(); poses.len()],
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
        let priors = self.priors();
        let smoothness = self.smoothness();
        let problem = Problem {
            context: Context { kinematics, camera: self.studio.camera, anchors: &anchors, columns: &columns },
            terms: vec![&flow, &contour, &tracks, &depth, &priors],
            smoothness: Some(&smoothness),
        };
        let options = Options { max_iterations: iterations, tolerance: 1e-4, damping: 1e-3 };
        solve(&problem, poses, active, &options).energies
    }

    fn smoothness(&self) -> Smoothness {
        let d2 = self.subject.diagonal.powi(2);
        let axis = self.studio.camera.view_from_world.matrix3.row(2);
        Smoothness {
            anchors: self.subject.pseudo.clone(),
            velocity: self.settings.velocity / d2,
            acceleration: self.settings.acceleration / d2,
            basis: Smoothness::stretched_basis(axis, self.settings.view_axis),
        }
    }

    fn priors(&self) -> JointPriors {
        let s = &self.settings;
        let kinematics = &self.subject.tree.kinematics;
        let d2 = self.subject.diagonal.powi(2);
        let across = |axis: DVec3, stiffness: f64| {
            let (a, b) = axis.any_orthonormal_pair();
            [a * stiffness.sqrt(), b * stiffness.sqrt()]
        };
        let mut all: Vec<JointPrior> =
            vec![JointPrior { stiffness: s.rest, slide_stiffness: s.slide / d2, ..JointPrior::FREE }; kinematics.len()];
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

    /// Tracks all frames from the rest pose in frame 0; `progress` hears of each frame.
    ///
    /// # Errors
    /// When `progress` asks to stop.
    pub fn track(&self, progress: &mut dyn FnMut(usize) -> ControlFlow<()>) -> Result<Vec<FramePose>, FitError> {
        let kinematics = &self.subject.tree.kinematics;
        let mut poses = vec![kinematics.rest()];
        let usual = self.mismatch(&poses[0], 0);
        for t in 1..self.frames.len() {
            poses.push(self.predict(&poses, t));
            self.settle(&mut poses, t);
            let unlike = self.mismatch(&poses[t], t);
            if unlike > usual * self.settings.search_above {
                let small = Small::new(&self.frames[t], self.studio.camera);
                let mut trial = poses.clone();
                trial[t] = swing_limbs(self.subject, &self.studio, &small, &poses[t]);
                self.settle(&mut trial, t);
                if self.mismatch(&trial[t], t) < unlike {
                    poses = trial;
                }
            }
            if self.given.starts_in(t) {
                self.given.anchor(self.subject, self.studio.camera, &self.draw(&poses[t], t), t);
            }
            if progress(t).is_break() {
                return Err(FitError::Stopped);
            }
        }
        Ok(poses)
    }

    /// Draws and solves the last frame in turn, from far to near.
    fn settle(&self, poses: &mut [FramePose], t: usize) {
        for round in 0..self.settings.rounds {
            let (huber, reach) =
                (self.at_round(self.settings.huber_px, round), self.at_round(self.settings.reach_px, round));
            let found = self.correspond(&poses[t], t, reach);
            self.solve(poses, t..t + 1, &[found], huber, 6);
        }
    }

    /// Geometric interpolation from a round's first to its last value.
    fn at_round(&self, (first, last): (f64, f64), round: usize) -> f64 {
        let u = round as f64 / (self.settings.rounds - 1).max(1) as f64;
        first * (last / first).powf(u)
    }

    /// The last pose, or the last pose moved on at the last velocity, whichever looks more like the frame.
    fn predict(&self, poses: &[FramePose], t: usize) -> FramePose {
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

    /// How unlike a frame a pose looks, in [0, 1].
    pub fn mismatch(&self, pose: &FramePose, t: usize) -> f64 {
        mismatch(&self.draw(pose, t), self.frames[t].image, self.frames[t].mask)
    }

    /// Refines all frames together: redraw every frame, solve jointly.
    pub fn refine(&self, poses: &mut [FramePose], rounds: usize) -> Vec<f64> {
        let mut energies = Vec::new();
        for _ in 0..rounds {
            let found: Vec<Correspondences> = (0..poses.len())
                .into_par_iter()
                .map(|t| self.correspond(&poses[t], t, self.settings.reach_px.1))
                .collect();
            energies = self.solve(poses, 0..poses.len(), &found, self.settings.huber_px.1, 8);
        }
        energies
    }
}

/// Huber threshold of depth residuals [σ].
const DEPTH_HUBER: f64 = 2.0;
/// Share of the last velocity that a prediction keeps.
const VELOCITY_KEPT: f64 = 0.9;

//! L majorised by squares around given poses (iteratively reweighted least squares; Lange, MM Optimization Algorithms, 2016).
//!
//! |r| ≤ r²/2a + a/2, equal at |r| = a, turns L's tracks, smoothness and regularity into the terms that Levenberg–Marquardt solves,
//! with L's own weights. Silhouette and colour have no such bound; the nearest contour stands in for both, heavier far from the
//! end, where it is off by many pixels. The Hessian of the whole is the metric in which L itself is minimised afterwards.

use animimic_fit::reference::{LIMIT_RAD, REG, SMOOTH, TRACK, TRANSLATION};
use animimic_fit::robust::Robust;
use animimic_fit::solver::{Problem, Smoothness};
use animimic_fit::stage1::solve::Stage;
use animimic_fit::terms::{Context, JointPrior, JointPriors, PixelTarget, Pixels};
use animimic_rig::smoothness::pseudo_anchors;
use animimic_rig::{Anchor, FramePose};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// The majorised energy is this many times L: the solver's damping has an absolute part.
pub const UNIT: f64 = 1e4;

/// Residuals below this count as squares [px].
const HUBER_PX: f64 = 0.3;
/// Reach of the contour [px].
const REACH_PX: f64 = 14.0;
/// A pixel of contour off by one adds a pixel to the silhouette's difference; colour and the pull from outside make it this much.
const CONTOUR: f64 = 4.0;
/// Least mean difference of a vertex in the reweighting [half the model's longest side].
const STILL: f64 = 1e-4;
/// Σ|component| against length, the mean over directions, in the plane and in space.
const L1: [f64; 2] = [4.0 / PI, 1.5];

/// Hands over L, majorised at `poses`; `boost` is a factor on the contour.
pub fn majorised<R>(stage: &Stage, poses: &[FramePose], boost: f64, work: impl FnOnce(&Problem) -> R) -> R {
    let n = poses.len();
    let tree = &stage.subject.tree.kinematics;
    let camera = stage.studio.camera;
    let (low, high) = stage.subject.asset.mesh.bounds();
    let unit = 0.5 * (high - low).max_element();
    let per_frame = UNIT / n as f64;

    let mut tracks = Pixels { targets: vec![Vec::new(); n], robust: Robust::Huber(HUBER_PX), weight: 1.0 };
    let mut contour = tracks.clone();
    let mut anchors: Vec<Anchor> = Vec::new();
    let found: Vec<_> = (0..n).into_par_iter().map(|t| stage.correspond(&poses[t], t, REACH_PX)).collect();
    for (t, c) in found.iter().enumerate() {
        let base = anchors.len() as u32;
        anchors.extend(c.anchors.iter().cloned());
        let total: f64 = c.tracks.iter().map(|p| p.weight).sum::<f64>().max(1e-9);
        // Huber's loss grows by twice its threshold.
        let track = per_frame * TRACK * L1[0] / (total * 0.5 * f64::from(camera.height)) / (2.0 * HUBER_PX);
        let edge = per_frame * CONTOUR * boost / f64::from(camera.width * camera.height) / (2.0 * HUBER_PX);
        for (source, target, scale) in [(&c.tracks, &mut tracks, track), (&c.contour, &mut contour, edge)] {
            target.targets[t].extend(source.iter().map(|p| PixelTarget {
                anchor: p.anchor + base,
                weight: p.weight * scale,
                ..*p
            }));
        }
    }

    let free = |j: &usize| tree.parents[*j].is_some() && tree.turns[*j];
    let joint = per_frame * REG / (0..tree.len()).filter(free).count().max(1) as f64;
    let held = JointPrior {
        limit_rad: LIMIT_RAD,
        limit_stiffness: joint,
        slide_stiffness: joint * TRANSLATION / (unit * unit),
        ..JointPrior::FREE
    };
    let joints = (0..tree.len()).map(|j| if tree.parents[j].is_some() { held } else { JointPrior::FREE }).collect();
    let priors = JointPriors { joints: vec![joints] };
    let smoothness = reweighted(stage, poses, unit);
    let columns: Vec<_> = anchors.par_iter().map(|a| a.columns(tree)).collect();
    work(&Problem {
        context: Context { kinematics: tree, camera, anchors: &anchors, columns: &columns },
        terms: vec![&tracks, &contour, &priors],
        smoothness: Some(&smoothness),
    })
}

/// L's smoothness, each vertex weighed by its own mean second difference.
fn reweighted(stage: &Stage, poses: &[FramePose], unit: f64) -> Smoothness {
    let n = poses.len();
    let posed: Vec<_> = poses.iter().map(|p| stage.subject.posed(p)).collect();
    let mean = |x: &[DVec3], stencil: &[f64]| {
        let lengths =
            x.windows(stencil.len()).map(|w| w.iter().zip(stencil).map(|(x, c)| *x * *c).sum::<DVec3>().length());
        lengths.sum::<f64>() / (x.len() + 1 - stencil.len()).max(1) as f64 + STILL * unit
    };
    let vertices = &stage.subject.vertices;
    let paces: Vec<[f64; 2]> = vertices
        .par_iter()
        .map(|a| {
            let path: Vec<DVec3> = posed.iter().map(|p| a.position(p)).collect();
            [mean(&path, &[-1.0, 1.0]), mean(&path, &[1.0, -2.0, 1.0])]
        })
        .collect();
    let weighed: Vec<Anchor> = vertices.iter().zip(&paces).map(|(a, p)| a.scaled(p[1].powf(-0.5))).collect();
    let sum = |k: usize| paces.iter().map(|p| p[k]).sum::<f64>();
    let weight = |order: usize| UNIT * SMOOTH[order - 1] * L1[1] / (2.0 * unit * n.saturating_sub(order).max(1) as f64);
    Smoothness {
        anchors: pseudo_anchors(&weighed, stage.subject.tree.kinematics.len()),
        velocity: weight(1) * sum(1) / sum(0),
        acceleration: weight(2),
        basis: DVec3::AXES,
    }
}

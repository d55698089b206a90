//! Helper bones: what a rig cannot do, done by a few more joints, so that refined motion stays an ordinary skinned clip.
//!
//! Smooth skinning decomposition with rigid bones (Le & Deng 2012, "Smooth Skinning Decomposition with Rigid Bones", eq. 2), with the base
//! rig locked: given maps M_k,f of the file's slots (its keys are never touched) and target vertices y_v,f over all frames of all clips, find
//! rigid displacements D_h,f of new joints and weights w so that
//!
//! E = Σ_f ω_f Σ_v ‖ Σ_k w_vk M_k,f X_v + Σ_h w_vh D_h,f A_h X_v − y_v,f ‖²,   w ≥ 0, Σ w = 1, at most four not 0,
//!
//! is small. `A_h` is the rest map of the slot that helper h is born on, so D_h = I is to stay with the displayed rest. Block descent:
//! transforms by weighted Procrustes frame by frame (`transforms`), weights by an active set vertex by vertex (`weights`); new helpers are
//! put where the error is largest (`seed`) until the goal is met.
//!
//! Where we differ: frame 0 of the problem is the displayed rest itself, so that the model stands where it stood also in files whose rest is not
//! their bind pose; directions that the vertices of a helper leave open follow the neighbouring frames; vertices that the base rig already
//! brings to their targets keep their weights; everything is deterministic for any number of threads.

mod joints;
mod problem;
mod seed;
mod spaces;
mod transforms;
mod weights;

use crate::residual::Residual;
use animimic_scene::{Mesh, Motion, Pose, Refined, Rig, Trajectory};
use problem::{Helper, Problem, State};
use rayon::prelude::*;
use std::borrow::Cow;

/// Influences per vertex that every importer reads.
pub const INFLUENCES: usize = 4;
/// Vertices on which transforms are found; weights are found on all.
const SAMPLE: usize = 2000;
/// Rounds of transforms and weights after helpers were added, and at the end.
const ROUNDS: usize = 4;
const LAST_ROUNDS: usize = 16;
/// Rounds in which the farthest points count for more, where the goal is missed with as many helpers as may be.
const EMPHASIS_ROUNDS: usize = 40;
/// Numbers of helpers that are tried, up to the most allowed.
const LADDER: [usize; 9] = [1, 2, 4, 6, 8, 12, 16, 24, 32];
/// Helpers that no vertex chose are sought anew elsewhere, so many times once there are as many as may be.
const REFILLS: usize = 3;
/// The 99th percentile over sampled vertices is brought under this share of the goal, for what the other vertices add.
const MARGIN: f64 = 0.9;
/// Helpers go on being added until the rms is this share of what skinning leaves, also where the goal is met before: else small motion is lost.
const KEPT_RMS: f64 = 0.25;
/// Residuals up to this share of the diagonal are not worth a helper.
const NEGLIGIBLE: f64 = 2e-4;

/// How far to go.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Most helpers.
    pub most: usize,
    /// 99th percentile of the residual that is good enough, over the vertices that leave the base skin [share of the rest diagonal].
    pub goal: f64,
}

impl Default for Settings {
    /// 32 helpers, half a percent of the diagonal.
    fn default() -> Self {
        Self { most: 32, goal: 0.005 }
    }
}

/// A rig with helpers, and the clips with their keys.
#[derive(Clone, Debug)]
pub struct Helped {
    /// The rig; helpers are the joints behind the given ones, without node, and the slots behind the given ones.
    pub rig: Rig,
    /// The clips in order; locals of the given joints are the given ones, bit for bit.
    pub motions: Vec<Motion>,
    /// Number of helpers.
    pub helpers: usize,
    /// What skinning alone leaves, over all vertices and frames.
    pub skinned: Residual,
    /// What is left with helpers, over all vertices and frames.
    pub residual: Residual,
    /// Farthest that a vertex at rest is from where it was [share of the diagonal]; not 0 only where the displayed rest is not the bind pose.
    pub rest: f64,
}

/// Why helpers cannot be found.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum HelperError {
    /// Motion, trajectory and mesh do not belong together.
    #[error("clip {clip:?}: {what}")]
    Mismatch {
        /// The clip's name.
        clip: String,
        /// What does not fit.
        what: String,
    },
}

/// Finds helpers that bring the skinned clips to their trajectories, the weights solved once over all of them.
///
/// A clip set that skinning already reproduces comes back as it is, without helpers.
///
/// # Errors
/// [`HelperError::Mismatch`] where a trajectory has another number of frames or vertices than its motion and the mesh, or is not finite.
pub fn fit(rig: &Rig, mesh: &Mesh, clips: &[Refined], settings: &Settings) -> Result<Helped, HelperError> {
    clips.iter().try_for_each(|c| check(rig, mesh, c))?;
    let diagonal = mesh.diagonal();
    if clips.iter().all(|c| c.trajectory.is_none()) {
        return Ok(unhelped(rig, clips, Residual::default()));
    }
    let surfaces: Vec<Cow<Trajectory>> = clips.iter().map(|c| surface(rig, c)).collect();
    let skinned = Residual::of_clips(rig, diagonal, clips.iter().map(|c| &c.motion).zip(surfaces.iter().map(|s| &**s)));
    let most = settings.most.min(LADDER[LADDER.len() - 1]);
    let problem = Problem::new(rig, mesh, clips, &surfaces, NEGLIGIBLE * diagonal);
    let (helpers, state) = grow(&problem, most, settings.goal * diagonal);
    if helpers.is_empty() {
        return Ok(unhelped(rig, clips, skinned));
    }
    let (rig, motions) = joints::attach(&problem, &helpers, &state, rig, mesh, clips);
    let residual = Residual::of_clips(&rig, diagonal, motions.iter().zip(surfaces.iter().map(|s| &**s)));
    let shown = rig.at_rest();
    let farthest = shown.iter().zip(&mesh.positions).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    let helpers = rig.skeleton.joints.len() - problem.joints;
    Ok(Helped { rig, motions, helpers, skinned, residual, rest: farthest / diagonal })
}

fn unhelped(rig: &Rig, clips: &[Refined], skinned: Residual) -> Helped {
    let motions = clips.iter().map(|c| c.motion.clone()).collect();
    Helped { rig: rig.clone(), motions, helpers: 0, skinned, residual: skinned, rest: 0.0 }
}

/// Where a clip's surface is: its trajectory, or where the skin has it.
pub fn surface<'a>(rig: &Rig, clip: &'a Refined) -> Cow<'a, Trajectory> {
    if let Some(trajectory) = &clip.trajectory {
        return Cow::Borrowed(trajectory);
    }
    let posed = |p: &Pose| rig.in_pose(p);
    let frames = clip.motion.poses.par_iter().map(posed).collect();
    Cow::Owned(Trajectory { fps: clip.motion.fps, frames })
}

/// Adds helpers until the goal is met or there are as many as may be.
fn grow(problem: &Problem, most: usize, goal: f64) -> (Vec<Helper>, State) {
    let mut helpers: Vec<Helper> = Vec::new();
    let mut state = problem.sample(SAMPLE);
    let start = state.error(problem, &helpers);
    if state.points.is_empty() || most == 0 {
        return (helpers, state);
    }
    let enough = |e: &problem::Errors| e.p99 <= MARGIN * goal && e.rms <= KEPT_RMS * start.rms;
    let last = LADDER.into_iter().rfind(|&n| n <= most).unwrap_or(0);
    for count in LADDER.into_iter().filter(|&n| n <= most).chain([last; REFILLS]) {
        problem::drop_idle(problem, &mut state, &mut helpers);
        let seeds = seed::seeds(problem, &state, &helpers, count.saturating_sub(helpers.len()));
        if seeds.is_empty() {
            break;
        }
        helpers.extend(seeds);
        for _ in 0..ROUNDS {
            weights::solve(problem, &mut state, &helpers);
            transforms::solve(problem, &state, &mut helpers);
        }
        if enough(&state.error(problem, &helpers)) {
            break;
        }
    }
    for _ in 0..LAST_ROUNDS {
        weights::solve(problem, &mut state, &helpers);
        transforms::solve(problem, &state, &mut helpers);
    }
    if state.error(problem, &helpers).p99 > MARGIN * goal {
        return emphasise(problem, helpers, state, goal);
    }
    (helpers, state)
}

/// Serves the farthest points better at the cost of the others, for as long as the 99th percentile falls.
fn emphasise(problem: &Problem, mut helpers: Vec<Helper>, mut state: State, goal: f64) -> (Vec<Helper>, State) {
    let mut best = (state.error(problem, &helpers).p99, helpers.clone(), state.clone());
    for _ in 0..EMPHASIS_ROUNDS {
        state.points.par_iter_mut().for_each(|p| p.emphasise(problem, &helpers, MARGIN * goal));
        weights::solve(problem, &mut state, &helpers);
        transforms::solve(problem, &state, &mut helpers);
        let p99 = state.error(problem, &helpers).p99;
        if p99 < best.0 {
            best = (p99, helpers.clone(), state.clone());
        }
    }
    (best.1, best.2)
}

pub(crate) fn check(rig: &Rig, mesh: &Mesh, clip: &Refined) -> Result<(), HelperError> {
    let poses = &clip.motion.poses;
    let joints = rig.skeleton.joints.len();
    let frames = clip.trajectory.as_ref().map(|t| &t.frames);
    let what = if let Some(p) = poses.iter().find(|p| p.locals.len() != joints) {
        format!("a pose of {} joints for a skeleton of {joints}", p.locals.len())
    } else if let Some(f) = frames.filter(|f| f.len() != poses.len()) {
        format!("{} poses and {} frames of vertices", poses.len(), f.len())
    } else if let Some(f) = frames.into_iter().flatten().find(|f| f.len() != mesh.positions.len()) {
        format!("a frame of {} vertices for a mesh of {}", f.len(), mesh.positions.len())
    } else if let Some(k) = frames.and_then(|all| all.iter().position(|f| f.iter().any(|p| !p.is_finite()))) {
        format!("frame {k} is not finite")
    } else {
        return Ok(());
    };
    Err(HelperError::Mismatch { clip: clip.motion.name.clone(), what })
}

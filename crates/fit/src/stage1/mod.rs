//! Stage 1: joint motion from a video, by analysis and synthesis.
//!
//! 1. Light from frame 0, where the model is in its rest pose.
//! 2. Frame by frame ([`track`]): draw the model where it is believed to be, find by dense flow and silhouettes where the
//!    drawn points are in the frame, solve for the pose (Levenberg–Marquardt on SO(3)ᴶ), draw again; several hypotheses are
//!    carried on where limbs may be taken for each other.
//! 3. All frames together ([`Stage::refine`]), coupled by smoothness over time; priors step back round by round.
//! 4. Where frames look wrong, poses from elsewhere in the clip are tried ([`repeats`]), and limbs that may lean the other way are
//!    mirrored ([`flips`]); what looks better is kept.
//! 5. All frames together at full strength, each point as smooth as itself ([`Stage::finish`], [`liveliness`]).
//! 6. The polish ([`polish`]): all terms with rendered colour and silhouette.
//! 7. How well each part is known ([`certainty`]).
//!
//! Each step but the polish is kept as it is done ([`steps`]): a fit that was cut off goes on there.
//!
//! 2 and 3 are done with and without what the rig suggests about hinges; the frames decide.

pub mod balls;
pub mod certainty;
pub mod contour;
pub mod correspond;
pub mod flesh;
pub mod flips;
pub mod given;
pub mod layers;
pub mod liveliness;
pub mod polish;
pub mod repeats;
pub mod search;
pub mod settings;
pub mod sight;
pub mod solve;
pub mod steps;
pub mod subject;
pub mod track;
mod trials;

use crate::FitError;
use animimic_render::{Light, rasterize_surface, solve_light};
use animimic_rig::FramePose;
use animimic_scene::{Asset, Camera, DepthKind, DepthMap, Image, Mask, Motion, Tracks};
pub use certainty::Certainty;
use contour::Contour;
use correspond::{Flow, Frame, contour_bias};
use given::Given;
pub use polish::Curve;
use rayon::prelude::*;
use search::mismatch;
pub use settings::Settings;
use sight::{Sight, Studio};
use solve::Stage;
use std::ops::{ControlFlow, Range};
use std::sync::atomic::{AtomicUsize, Ordering};
use steps::Steps;
pub use steps::{Forgetful, Keeper, Saved};
use subject::Subject;

/// What stage 1 looks at. All pictures have the camera's size.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// The model with its rig.
    pub asset: &'a Asset,
    /// The camera.
    pub camera: &'a Camera,
    /// Video frames.
    pub frames: &'a [Image],
    /// Object masks \[frame\].
    pub masks: &'a [Mask],
    /// The background \[frame\], or one picture for all frames.
    pub backgrounds: &'a [Image],
    /// Dense flow between two pictures.
    pub flow: &'a Flow<'a>,
    /// Point tracks made elsewhere, in pixels of the camera; where they cover a frame they replace the flow.
    pub tracks: Option<&'a Tracks>,
    /// Depth made elsewhere \[frame\], of any size; empty if there is none.
    pub depth: &'a [DepthMap],
    /// What the depth values mean.
    pub depth_kind: DepthKind,
}

/// What stage 1 found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Solved frames.
    pub frames: Vec<FramePose>,
    /// The same as a clip of the model's own skeleton.
    pub motion: Motion,
    /// Energy after each step of the final joint solve.
    pub energies: Vec<f64>,
    /// Energy of each term after each step of the polish.
    pub curves: Vec<Curve>,
    /// How unlike the video each frame looks, in [0, 1].
    pub mismatch: Vec<f64>,
    /// How well each part is known.
    pub certainty: Vec<Certainty>,
    /// Trials whose energy was not a number; the solve went on from the best before them, in shorter steps.
    pub not_finite: usize,
}

/// What the fit is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Frame by frame.
    Track,
    /// All frames together, redrawn round by round.
    Refine,
    /// Limbs mirrored in depth.
    Flip,
    /// All frames together, with rendered losses.
    Polish,
}

impl Phase {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Phase::Track => "tracking",
            Phase::Refine => "refinement",
            Phase::Flip => "flips",
            Phase::Polish => "polish",
        }
    }
}

/// What goes on from now, and how far the fit has come, in [0, 1]; `Break` stops it.
pub type Progress<'a> = dyn FnMut(Phase, f64) -> ControlFlow<()> + 'a;

/// Share of the time of a hypothesis that tracking takes, and where in the fit the later parts begin, for the progress bar.
const TRACKING_SHARE: f64 = 0.6;
const FINISH_AT: f64 = 0.75;
const FLIPS_AT: f64 = 0.8;
const FLIPPED_AT: f64 = 0.85;
const POLISH_AT: f64 = 0.93;

/// Finds the motion of a rigged model in a video. Its steps are kept by `keeper`, and taken from there where they were done before.
///
/// # Errors
/// Inputs that do not belong together, a model that cannot be drawn, a keeper that cannot keep, or a stop.
pub fn fit(
    input: &Input,
    settings: Settings,
    name: &str,
    fps: f64,
    keeper: &mut dyn Keeper,
    progress: &mut Progress,
) -> Result<Outcome, FitError> {
    check(input)?;
    let subject = Subject::new(input.asset)?;
    let light = first_light(input, &subject)?;
    let stage = stage(input, &subject, &light, settings);
    let mut steps = Steps::new(&stage, keeper);
    let mut frames = best_hypothesis(&mut steps, progress)?;
    let rounds = stage.settings.final_rounds;
    let half = rounds / 2;
    finish(&mut steps, &mut frames, 0..half, (FINISH_AT, FLIPS_AT), progress)?;
    go_on(progress, Phase::Flip, FLIPS_AT)?;
    steps.take("repeats", &mut frames, |poses| {
        stage.repeat(poses);
        Vec::new()
    })?;
    steps.take("flips", &mut frames, |poses| {
        stage.flip_limbs(poses);
        Vec::new()
    })?;
    let energies = finish(&mut steps, &mut frames, half..rounds, (FLIPPED_AT, POLISH_AT), progress)?;
    go_on(progress, Phase::Polish, POLISH_AT)?;
    let curves = stage.polish(&mut frames, polish::SETTLED);
    let mismatch = stage.mismatches(&frames);
    let certainty = stage.certainty(&frames, &mismatch);
    let poses = frames.iter().map(|f| subject.file_pose(f)).collect();
    let motion = Motion { name: name.into(), fps, poses };
    let not_finite = stage.not_finite.load(Ordering::Relaxed);
    Ok(Outcome { motion, frames, energies, curves, mismatch, certainty, not_finite })
}

fn go_on(progress: &mut Progress, phase: Phase, done: f64) -> Result<(), FitError> {
    if progress(phase, done).is_break() { Err(FitError::Stopped) } else { Ok(()) }
}

/// Some of the rounds at the final strength, which take the part `share` of the progress; the energies of the last.
fn finish(
    steps: &mut Steps,
    frames: &mut Vec<FramePose>,
    rounds: Range<usize>,
    share: (f64, f64),
    progress: &mut Progress,
) -> Result<Vec<f64>, FitError> {
    let mut energies = Vec::new();
    let stage = steps.stage;
    for round in rounds.clone() {
        let done = (round - rounds.start) as f64 / rounds.len() as f64;
        go_on(progress, Phase::Refine, share.0 + (share.1 - share.0) * done)?;
        energies = steps.take(&format!("finish {round}"), frames, |poses| stage.finish(poses))?;
    }
    Ok(energies)
}

/// A motion that follows the rig's hinges may look this many times as unlike the video, beyond what frame 0 does, and still be
/// preferred.
const PLAUSIBLE: f64 = 1.2;

/// A motion whose frames look no more unlike than frame 0 and this share of that, on average, needs no other hypothesis.
const GOOD: f64 = 0.1;

/// Tracks and refines with and, where the frames ask for it, without what the rig suggests; returns what they speak for.
fn best_hypothesis(steps: &mut Steps, progress: &mut Progress) -> Result<Vec<FramePose>, FitError> {
    let stage = steps.stage;
    let guesses: &[f64] = if stage.guesses_matter() { &[1.0, stage.settings.final_priors] } else { &[1.0] };
    let (count, rounds) = (stage.frames.len(), stage.settings.batch_rounds);
    let mut best: Option<(f64, Vec<FramePose>)> = None;
    let mut costs: Option<Vec<f64>> = None;
    for (k, &weight) in guesses.iter().enumerate() {
        if best.as_ref().is_some_and(|b| b.0 < GOOD * stage.usual_mismatch) {
            break;
        }
        let mut share = |phase, done: f64| progress(phase, FINISH_AT * (k as f64 + done) / guesses.len() as f64);
        let mut tracked = |t: usize| share(Phase::Track, TRACKING_SHARE * t as f64 / count as f64);
        let tracked = steps.track(&format!("tracking {k}"), weight, costs.as_deref(), &mut tracked)?;
        let Some(tracked) = tracked else { continue };
        let mut frames = tracked.poses;
        for round in 0..rounds {
            let done = TRACKING_SHARE + (1.0 - TRACKING_SHARE) * round as f64 / rounds as f64;
            go_on(&mut share, Phase::Refine, done)?;
            let refine = |poses: &mut Vec<FramePose>| stage.refine(poses, round, weight);
            steps.take(&format!("refinement {k}.{round}"), &mut frames, refine)?;
        }
        let unlike = stage.mismatches(&frames).iter().sum::<f64>() / count as f64 - stage.usual_mismatch;
        costs = Some(tracked.costs);
        // What the rig suggests is given up only where the frames clearly speak against it.
        if best.as_ref().is_none_or(|b| unlike * PLAUSIBLE < b.0) {
            best = Some((unlike, frames));
        }
    }
    Ok(best.expect("one hypothesis at least").1)
}

fn check(input: &Input) -> Result<(), FitError> {
    let size = (input.camera.width as usize, input.camera.height as usize);
    let wrong =
        |what: &str| Err(FitError::Input(format!("{what} do not have the camera's size {}×{}", size.0, size.1)));
    if input.frames.is_empty() || input.masks.len() != input.frames.len() || input.backgrounds.is_empty() {
        return Err(FitError::Input("a fit needs frames, one mask for each, and a background".into()));
    }
    if input.frames.iter().chain(input.backgrounds).any(|i| (i.width, i.height) != size) {
        return wrong("pictures");
    }
    if input.masks.iter().any(|m| (m.width, m.height) != size) {
        return wrong("masks");
    }
    check_given(input)
}

fn check_given(input: &Input) -> Result<(), FitError> {
    let count = input.frames.len();
    if !input.depth.is_empty() && input.depth.len() != count {
        return Err(FitError::Input(format!("{} depth maps for {count} frames", input.depth.len())));
    }
    if input.depth.iter().any(|m| m.width == 0 || m.values.len() != m.width * m.height || m.values.is_empty()) {
        return Err(FitError::Input("a depth map does not hold one value a pixel".into()));
    }
    let Some(tracks) = input.tracks else { return Ok(()) };
    let points = tracks.query_frame.len();
    let rows = tracks.pixels.iter().map(Vec::len).chain(tracks.confidence.iter().map(Vec::len));
    if tracks.pixels.len() != count || tracks.confidence.len() != count || rows.into_iter().any(|n| n != points) {
        return Err(FitError::Input(format!("tracks do not hold {points} points in each of {count} frames")));
    }
    Ok(())
}

/// The light in frame 0, where the model stands in its rest pose.
pub fn first_light(input: &Input, subject: &Subject) -> Result<Light, FitError> {
    let rest = subject.skinned(&subject.posed(&subject.tree.kinematics.rest()));
    let raster = rasterize_surface(input.camera, &subject.surface, &rest, true);
    Ok(solve_light(input.camera, &subject.surface, &rest, &raster, &input.frames[0], Some(&input.masks[0]))?)
}

/// Gathers what tracking and refinement need.
pub fn stage<'a>(input: &Input<'a>, subject: &'a Subject<'a>, light: &'a Light, settings: Settings) -> Stage<'a> {
    let settings = if input.depth.is_empty() { settings } else { settings.with_known_depth() };
    let frames: Vec<Frame> = input
        .frames
        .par_iter()
        .zip(input.masks)
        .enumerate()
        .map(|(t, (image, mask))| Frame {
            image,
            mask,
            contour: Contour::new(mask),
            background: &input.backgrounds[t.min(input.backgrounds.len() - 1)],
        })
        .collect();
    let studio = Studio { camera: input.camera, light };
    let first = Sight::draw(subject, &studio, frames[0].background, &subject.tree.kinematics.rest());
    let contour_bias_px = contour_bias(&first, &frames[0]);
    let usual_mismatch = mismatch(&first, frames[0].image, frames[0].mask);
    let given = Given::new(input.tracks, input.depth, input.depth_kind, subject, input.camera, &first);
    let not_finite = AtomicUsize::new(0);
    Stage {
        subject,
        studio,
        frames,
        flow: input.flow,
        given,
        settings,
        contour_bias_px,
        usual_mismatch,
        not_finite,
        flesh: None,
    }
}

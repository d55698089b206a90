//! The paper's own recipe, for comparison: Adam on 6D rotations and translations, phase by phase.
//!
//! Same renderer, same terms and the same loss for any motion ([`Loss`]); only parametrisation, optimiser and schedule are the
//! reference's: Adam 1e-3, weight decay 1e-4, gradient clip 1, rate halved after 20 iterations without progress; 50
//! iterations for each frame alone, begun where the last frame ended, then 200 for all frames together.
//! Constants: docs/method.md, "The reference recipe".

mod adam;
mod loss;
mod six_d;

pub use adam::{Adam, Plateau};
pub use loss::{LIMIT_RAD, Loss, Parts, REG, SMOOTH, TRACK, TRANSLATION};
pub use six_d::SixD;

use crate::FitError;
use crate::stage1::Curve;
use animimic_rig::{FramePose, Kinematics};
use rayon::prelude::*;
use std::ops::ControlFlow;

/// Lengths and limits of the two phases.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    /// Iterations of each frame alone.
    pub alone: usize,
    /// Iterations of all frames together.
    pub together: usize,
}

impl Default for Schedule {
    fn default() -> Self {
        Self { alone: 50, together: 200 }
    }
}

/// Angle from rest beyond which a joint is pulled back while each frame is alone [rad].
const LIMIT_ALONE_RAD: f64 = 1.0;

/// What a run found.
#[derive(Clone, Debug)]
pub struct Run {
    /// Poses of all frames.
    pub poses: Vec<FramePose>,
    /// Total loss before each iteration of the second phase.
    pub losses: Vec<f64>,
    /// The same part by part.
    pub parts: Vec<Curve>,
}

/// The tree with every joint free to slide, as the reference has it.
pub fn free(kinematics: &Kinematics) -> Kinematics {
    let (parents, pivots) = (kinematics.parents.clone(), kinematics.pivots.clone());
    Kinematics::new(parents, pivots, kinematics.turns.clone(), kinematics.turns.clone())
}

/// Runs the recipe from the rest pose; `progress` hears the share done and the loss.
///
/// # Errors
/// When `progress` asks to stop.
pub fn run(
    loss: &Loss,
    frames: usize,
    schedule: &Schedule,
    progress: &mut dyn FnMut(f64, Option<f64>) -> ControlFlow<()>,
) -> Result<Run, FitError> {
    let layout = SixD::new(loss.kinematics());
    let work = ((schedule.alone + schedule.together) * frames).max(1) as f64;
    let mut parameters: Vec<Vec<f64>> = Vec::with_capacity(frames);
    for t in 0..frames {
        let start = parameters.last().cloned().unwrap_or_else(|| layout.rest());
        parameters.push(alone(loss, &layout, t, start, schedule.alone));
        if progress(((t + 1) * schedule.alone) as f64 / work, None).is_break() {
            return Err(FitError::Stopped);
        }
    }
    let size = layout.size();
    let mut all: Vec<f64> = parameters.concat();
    let (mut adam, mut plateau) = (Adam::new(all.len()), Plateau::default());
    let mut history: Vec<Parts> = Vec::with_capacity(schedule.together);
    for i in 0..schedule.together {
        let poses: Vec<FramePose> = all.par_chunks(size).map(|p| layout.pose(p)).collect();
        let (parts, gradients) = loss.with_gradient(&poses);
        let gradient: Vec<f64> =
            all.par_chunks(size).zip(&gradients).flat_map_iter(|(p, g)| layout.pullback(p, g)).collect();
        history.push(parts);
        plateau.hear(parts.total());
        adam.step(&mut all, gradient, plateau.rate());
        let done = (frames * (schedule.alone + i + 1)) as f64 / work;
        if progress(done, Some(parts.total())).is_break() {
            return Err(FitError::Stopped);
        }
    }
    let curve = |(k, name): (usize, &str)| Curve {
        name: name.into(),
        values: history.iter().map(|p| p.named()[k].1).collect(),
    };
    Ok(Run {
        poses: all.par_chunks(size).map(|p| layout.pose(p)).collect(),
        losses: history.iter().map(Parts::total).collect(),
        parts: Parts::default().named().map(|(name, _)| name).into_iter().enumerate().map(curve).collect(),
    })
}

/// One frame by itself.
fn alone(loss: &Loss, layout: &SixD, frame: usize, mut parameters: Vec<f64>, iterations: usize) -> Vec<f64> {
    let (mut adam, mut plateau) = (Adam::new(parameters.len()), Plateau::default());
    for _ in 0..iterations {
        let pose = layout.pose(&parameters);
        let (parts, gradient) = loss.frame(frame, &pose, LIMIT_ALONE_RAD, true);
        plateau.hear(parts.total());
        let gradient = layout.pullback(&parameters, &gradient);
        adam.step(&mut parameters, gradient, plateau.rate());
    }
    parameters
}

#[cfg(test)]
mod tests;

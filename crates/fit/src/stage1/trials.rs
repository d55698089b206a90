//! Trials: another motion over a stretch of frames is solved, and kept where the frames then look better.

use super::solve::Stage;
use animimic_rig::FramePose;
use rayon::prelude::*;
use std::ops::Range;

/// Rounds of drawing and solving per trial.
const ROUNDS: usize = 2;
/// A trial must look better by this factor to be kept.
const CLEARLY: f64 = 0.98;
/// Frames solved after a stretch, so that the motion goes on smoothly.
const AFTER: usize = 2;

impl Stage<'_> {
    /// Solves `trial`, which differs from `poses` in some frames, around them; takes it over where it looks clearly better. `mismatches` are
    /// those of `poses` \[frame\] and stay so.
    pub(super) fn try_out(
        &self,
        mut trial: Vec<FramePose>,
        frames: Range<usize>,
        poses: &mut [FramePose],
        mismatches: &mut [f64],
    ) -> bool {
        let active = frames.start..(frames.end + AFTER).min(poses.len());
        for _ in 0..ROUNDS {
            let found = self.correspond_all(&trial, active.clone());
            self.solve(&mut trial[..active.end], active.clone(), &found, self.final_strength(), 8);
        }
        let there: Vec<f64> = active.clone().into_par_iter().map(|t| self.mismatch(&trial[t], t)).collect();
        let here = &mut mismatches[active.clone()];
        let better = there.iter().sum::<f64>() < CLEARLY * here.iter().sum::<f64>();
        if better {
            here.copy_from_slice(&there);
            poses[active.clone()].clone_from_slice(&trial[active]);
        }
        better
    }
}

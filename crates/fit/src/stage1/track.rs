//! Frame by frame, with several hypotheses at a time.
//!
//! Limbs that cross, or that move farther than their own width between two frames, can be taken for each other or be lost, and
//! the frame itself may not tell. So tracking is a beam search: where a frame looks wrong, each hypothesis is also continued
//! with its limbs swung to where they look right, and the few whose frames so far look most like the video are carried on.

use super::search::{Small, swing_limbs};
use super::solve::Stage;
use crate::FitError;
use animimic_rig::FramePose;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// Hypotheses carried from frame to frame.
const BEAM: usize = 3;
/// The best of them, whose limbs are swung.
const SWINGING: usize = 2;
/// Hypotheses whose points are nearer than this are the same [rest diagonal, root mean square].
const SAME: f64 = 0.01;
/// A hypothesis that looks worse than the best by more than this many times frame 0's mismatch is given up.
const GIVE_UP: f64 = 2.0;

/// A tracking whose frames so far look this many times as unlike as another one's is given up.
const HOPELESS: f64 = 1.15;
/// It has at least so many frames to show what it is worth.
const FAIR_START: usize = 8;

/// A motion as tracked.
pub struct Tracked {
    /// Poses \[frame\].
    pub poses: Vec<FramePose>,
    /// Mismatch of the frames up to each, summed \[frame\].
    pub costs: Vec<f64>,
}

/// One story of the motion so far.
#[derive(Clone)]
struct Story {
    poses: Vec<FramePose>,
    /// Sum of mismatches.
    cost: f64,
}

impl Stage<'_> {
    /// Tracks all frames from the rest pose in frame 0, with guesses from the rig weighed by `guesses`; `progress` hears of
    /// each frame. `None` where it falls hopelessly behind `rival`, the costs of another tracking.
    ///
    /// # Errors
    /// When `progress` asks to stop.
    pub fn track(
        &self,
        guesses: f64,
        rival: Option<&[f64]>,
        progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
    ) -> Result<Option<Tracked>, FitError> {
        let rest = self.subject.tree.kinematics.rest();
        let mut beam = vec![Story { poses: vec![rest], cost: 0.0 }];
        let mut costs = vec![0.0];
        for t in 1..self.frames.len() {
            let mut next = Vec::new();
            for (rank, story) in beam.iter().enumerate() {
                next.extend(self.continued(story, t, guesses, rank < SWINGING));
            }
            next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            beam.clear();
            let limit = next[0].cost + GIVE_UP * self.usual_mismatch;
            for story in next {
                if beam.len() < BEAM && story.cost <= limit && beam.iter().all(|b| self.distance(b, &story) > SAME) {
                    beam.push(story);
                }
            }
            if self.given.starts_in(t) {
                self.given.anchor(self.subject, self.studio.camera, &self.draw(&beam[0].poses[t], t), t);
            }
            if progress(t).is_break() {
                return Err(FitError::Stopped);
            }
            costs.push(beam[0].cost);
            if t >= FAIR_START && rival.is_some_and(|r| beam[0].cost > HOPELESS * r[t]) {
                return Ok(None);
            }
        }
        Ok(Some(Tracked { poses: beam.swap_remove(0).poses, costs }))
    }

    /// A story with one frame more: as predicted, and with limbs swung where that looks wrong.
    fn continued(&self, story: &Story, t: usize, guesses: f64, swing: bool) -> Vec<Story> {
        let settled = |start: FramePose| {
            let mut poses = story.poses.clone();
            poses.push(start);
            self.settle(&mut poses, t, guesses);
            let unlike = self.mismatch(&poses[t], t);
            (Story { poses, cost: story.cost + unlike }, unlike)
        };
        let (straight, unlike) = settled(self.predict(&story.poses, t));
        if !swing || unlike <= self.usual_mismatch * self.settings.search_above {
            return vec![straight];
        }
        let small = Small::new(&self.frames[t], self.studio.camera);
        let pose = &straight.poses[t];
        let mut starts: Vec<FramePose> = [false, true]
            .iter()
            .filter_map(|&backwards| swing_limbs(self.subject, &self.studio, &small, pose, backwards))
            .collect();
        if starts.len() == 2 && self.pose_distance(&starts[0], &starts[1]) < SAME {
            starts.pop();
        }
        let mut all: Vec<Story> = starts.into_par_iter().map(|start| settled(start).0).collect();
        all.push(straight);
        all
    }

    /// How far two stories are apart in their last frame.
    fn distance(&self, a: &Story, b: &Story) -> f64 {
        self.pose_distance(&a.poses[a.poses.len() - 1], &b.poses[b.poses.len() - 1])
    }

    /// How far two poses are apart [rest diagonal, root mean square over vertices].
    fn pose_distance(&self, a: &FramePose, b: &FramePose) -> f64 {
        let (a, b) = (self.subject.posed(a), self.subject.posed(b));
        let sum: f64 = self.subject.pseudo.iter().map(|p| p.position(&a).distance_squared(p.position(&b))).sum();
        sum.sqrt() / self.subject.diagonal
    }
}

//! Frame by frame, with several hypotheses at a time.
//!
//! Limbs that cross, or that move farther than their own width between two frames, can be taken for each other or be lost, and
//! the frame itself may not tell. So tracking is a beam search: where a frame looks wrong, each hypothesis is also continued
//! with its limbs swung to where they look right, and the few whose frames so far look most like the video are carried on.

use super::search::{Small, swing_limbs};
use super::solve::Stage;
use super::steps::Saved;
use crate::FitError;
use animimic_rig::FramePose;
use rayon::prelude::*;

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

/// All that tracking knows after some frames.
#[derive(Clone)]
pub struct Beam {
    /// The best first.
    stories: Vec<Story>,
    /// Cost of the best story after each frame \[frame\].
    costs: Vec<f64>,
}

impl Beam {
    /// Frames that are tracked.
    pub fn frames(&self) -> usize {
        self.costs.len()
    }

    pub(super) fn stories(&self) -> impl Iterator<Item = &[FramePose]> {
        self.stories.iter().map(|s| s.poses.as_slice())
    }

    /// As poses and numbers: each story's cost, then each frame's.
    pub(super) fn to_saved(&self) -> Saved {
        let costs = self.stories.iter().map(|s| s.cost).chain(self.costs.iter().copied());
        Saved { stories: self.stories.iter().map(|s| s.poses.clone()).collect(), numbers: costs.collect() }
    }

    /// The opposite; `None` where the poses and numbers are not of a beam.
    pub(super) fn from_saved(saved: Saved) -> Option<Self> {
        let costs = saved.numbers.get(saved.stories.len()..)?.to_vec();
        let whole = !costs.is_empty() && saved.stories.iter().all(|s| s.len() == costs.len());
        let stories = saved.stories.into_iter().zip(saved.numbers).map(|(poses, cost)| Story { poses, cost }).collect();
        whole.then_some(Self { stories, costs })
    }
}

impl Stage<'_> {
    /// Where tracking begins: the rest pose in frame 0.
    pub fn at_rest(&self) -> Beam {
        let poses = vec![self.subject.tree.kinematics.rest()];
        Beam { stories: vec![Story { poses, cost: 0.0 }], costs: vec![0.0] }
    }

    /// Tracks the frames that `beam` lacks, with guesses from the rig weighed by `guesses`; `each` hears after each frame.
    /// `None` where it falls hopelessly behind `rival`, the costs of another tracking.
    ///
    /// # Errors
    /// Those of `each`.
    pub fn track(
        &self,
        guesses: f64,
        rival: Option<&[f64]>,
        mut beam: Beam,
        each: &mut dyn FnMut(&Beam) -> Result<(), FitError>,
    ) -> Result<Option<Tracked>, FitError> {
        for t in beam.frames()..self.frames.len() {
            let stories = beam.stories.par_iter().enumerate();
            let continued = stories.map(|(rank, story)| self.continued(story, t, guesses, rank < SWINGING));
            let mut next: Vec<Story> = continued.collect::<Vec<_>>().into_iter().flatten().collect();
            next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            let mut kept: Vec<Story> = Vec::new();
            let limit = next[0].cost + GIVE_UP * self.usual_mismatch;
            for story in next {
                if kept.len() < BEAM && story.cost <= limit && kept.iter().all(|b| self.distance(b, &story) > SAME) {
                    kept.push(story);
                }
            }
            beam.stories = kept;
            let best = &beam.stories[0];
            if self.given.starts_in(t) {
                self.given.anchor(self.subject, self.studio.camera, &self.draw(&best.poses[t], t), t);
            }
            beam.costs.push(best.cost);
            if t >= FAIR_START && rival.is_some_and(|r| best.cost > HOPELESS * r[t]) {
                return Ok(None);
            }
            each(&beam)?;
        }
        Ok(Some(Tracked { poses: beam.stories.swap_remove(0).poses, costs: beam.costs }))
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
    pub(super) fn pose_distance(&self, a: &FramePose, b: &FramePose) -> f64 {
        let (a, b) = (self.subject.posed(a), self.subject.posed(b));
        let sum: f64 = self.subject.pseudo.iter().map(|p| p.position(&a).distance_squared(p.position(&b))).sum();
        sum.sqrt() / self.subject.diagonal
    }
}

//! The steps of a fit, kept as they are done, so that one that was cut off goes on where it was.
//!
//! A step's result is all that later steps depend on, exact to the last bit: a fit that goes on ends as one that was never
//! stopped. Only tracks that begin after frame 0 are bound to the surface while tracking, so such fits are not kept.

use super::solve::Stage;
use super::track::{Beam, Tracked};
use crate::FitError;
use animimic_rig::FramePose;
use std::ops::ControlFlow;
use std::sync::atomic::Ordering;

/// What a step found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Saved {
    /// Poses, \[story\]\[frame\]; one story but for tracking.
    pub stories: Vec<Vec<FramePose>>,
    /// Numbers that go with them.
    pub numbers: Vec<f64>,
}

/// A place outside this crate that keeps what steps found.
pub trait Keeper {
    /// What a step found, if that was kept.
    fn load(&mut self, step: &str) -> Option<Saved>;
    /// Keeps what a step found, in place of what it found before.
    ///
    /// # Errors
    /// [`FitError::Keep`] where the place refuses.
    fn save(&mut self, step: &str, saved: &Saved) -> Result<(), FitError>;
}

/// Keeps nothing.
pub struct Forgetful;

impl Keeper for Forgetful {
    fn load(&mut self, _step: &str) -> Option<Saved> {
        None
    }
    fn save(&mut self, _step: &str, _saved: &Saved) -> Result<(), FitError> {
        Ok(())
    }
}

/// Tracking is kept every so many frames: a few seconds' work at most is done again.
const TRACKED_FRAMES: usize = 8;

/// Does steps, or takes them from where they were kept.
pub(super) struct Steps<'a> {
    pub stage: &'a Stage<'a>,
    keeper: &'a mut dyn Keeper,
    keeps: bool,
}

impl<'a> Steps<'a> {
    pub fn new(stage: &'a Stage<'a>, keeper: &'a mut dyn Keeper) -> Self {
        let keeps = !(1..stage.frames.len()).any(|t| stage.given.starts_in(t));
        Self { stage, keeper, keeps }
    }

    /// Changes all frames by `work`, which returns energies, unless that was done before.
    pub fn take(
        &mut self,
        step: &str,
        poses: &mut Vec<FramePose>,
        work: impl FnOnce(&mut Vec<FramePose>) -> Vec<f64>,
    ) -> Result<Vec<f64>, FitError> {
        let kept = self.load(step).and_then(|mut s| Some((s.stories.pop()?, s.numbers)));
        if let Some((kept, energies)) = kept.filter(|k| self.fits(&k.0)) {
            *poses = kept;
            return Ok(energies);
        }
        let energies = work(poses);
        self.save(step, Saved { stories: vec![poses.clone()], numbers: energies.clone() })?;
        Ok(energies)
    }

    /// Tracks all frames, from where it was left off; `progress` hears of each frame.
    pub fn track(
        &mut self,
        step: &str,
        guesses: f64,
        rival: Option<&[f64]>,
        progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
    ) -> Result<Option<Tracked>, FitError> {
        let stage = self.stage;
        let beam = match self.load(step) {
            Some(saved) if saved.stories.is_empty() => return Ok(None),
            Some(saved) => Beam::from_saved(saved).filter(|b| b.stories().all(|s| stage.can_be(s))),
            None => None,
        };
        let beam = beam.unwrap_or_else(|| stage.at_rest());
        let tracked = stage.track(guesses, rival, beam, &mut |beam| {
            let stop = progress(beam.frames() - 1).is_break();
            if stop || beam.frames() % TRACKED_FRAMES == 0 || beam.frames() == stage.frames.len() {
                self.save(step, beam.to_saved())?;
            }
            if stop { Err(FitError::Stopped) } else { Ok(()) }
        })?;
        if tracked.is_none() {
            // No story: it was given up.
            self.save(step, Saved::default())?;
        }
        Ok(tracked)
    }

    fn fits(&self, poses: &[FramePose]) -> bool {
        poses.len() == self.stage.frames.len() && self.stage.can_be(poses)
    }

    /// The last number counts what was not finite so far.
    fn load(&mut self, step: &str) -> Option<Saved> {
        let mut saved = self.keeps.then(|| self.keeper.load(step)).flatten()?;
        self.stage.not_finite.store(saved.numbers.pop()? as usize, Ordering::Relaxed);
        Some(saved)
    }

    fn save(&mut self, step: &str, mut saved: Saved) -> Result<(), FitError> {
        saved.numbers.push(self.stage.not_finite.load(Ordering::Relaxed) as f64);
        if self.keeps { self.keeper.save(step, &saved) } else { Ok(()) }
    }
}

impl Stage<'_> {
    /// Whether poses can be of this model in the first frames of this video.
    fn can_be(&self, poses: &[FramePose]) -> bool {
        let joints = self.subject.tree.kinematics.len();
        let whole = |p: &FramePose| p.rotations.len() == joints && p.displacements.len() == joints;
        (1..=self.frames.len()).contains(&poses.len()) && poses.iter().all(whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::with_video;
    use crate::stage1::{Input, Outcome, Phase, Settings, fit};
    use std::collections::BTreeMap;

    /// Keeps in memory.
    #[derive(Clone, Default)]
    struct Memory(BTreeMap<String, Saved>);

    impl Keeper for Memory {
        fn load(&mut self, step: &str) -> Option<Saved> {
            self.0.get(step).cloned()
        }
        fn save(&mut self, step: &str, saved: &Saved) -> Result<(), FitError> {
            self.0.insert(step.into(), saved.clone());
            Ok(())
        }
    }

    /// Fits until `progress` was heard `most` times.
    fn run(input: &Input, memory: &mut Memory, most: usize) -> (Result<Outcome, FitError>, usize) {
        let mut heard = 0;
        let mut progress = |_: Phase, _: f64| {
            heard += 1;
            if heard > most { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let outcome = fit(input, Settings::default(), "a", 24.0, memory, &mut progress);
        (outcome, heard)
    }

    #[test]
    fn a_fit_stopped_anywhere_goes_on_to_the_very_same_end() {
        with_video(|input, _, _| {
            let input = Input { tracks: None, depth: &[], ..*input };
            let (whole, steps) = run(&input, &mut Memory::default(), usize::MAX);
            let whole = whole.expect("fits");
            for most in 0..steps {
                let mut memory = Memory::default();
                assert!(matches!(run(&input, &mut memory, most).0, Err(FitError::Stopped)), "stopped after {most}");
                let again = run(&input, &mut memory, usize::MAX).0.expect("goes on");
                assert_eq!(again.frames, whole.frames, "stopped after {most}");
                assert_eq!((again.energies, again.mismatch), (whole.energies.clone(), whole.mismatch.clone()));
            }
            // Stopped at every step in turn, it still arrives.
            let (mut memory, mut stops) = (Memory::default(), 0);
            let end = loop {
                let before = memory.0.len();
                match run(&input, &mut memory, before + stops).0 {
                    Ok(outcome) => break outcome,
                    Err(_) => stops += 1,
                }
                assert!(stops <= steps, "it does not get on");
            };
            println!("{steps} places to stop at; stopped {stops} times in one fit, {} steps kept", memory.0.len());
            assert!(stops > 2);
            assert_eq!(end.frames, whole.frames);
        });
    }

    #[test]
    fn what_was_kept_of_another_model_is_not_taken() {
        with_video(|input, _, _| {
            let input = Input { tracks: None, depth: &[], ..*input };
            let mut memory = Memory::default();
            let whole = run(&input, &mut memory, usize::MAX).0.expect("fits");
            for saved in memory.0.values_mut() {
                saved.stories.iter_mut().flatten().for_each(|p| p.rotations.truncate(1));
            }
            let again = run(&input, &mut memory, usize::MAX).0.expect("fits");
            assert_eq!(again.frames, whole.frames);
        });
    }
}

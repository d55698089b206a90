//! Hands a take to stage 1 and says in words what the fit was unsure of.

use super::LossCurve;
use crate::Error;
use crate::cues::dense_flow;
use crate::event::{Event, Progress};
use crate::pictures::background_picture;
use animimic_fit::stage1::subject::Subject;
use animimic_fit::stage1::{self, Certainty, Input, Keeper, Settings};
use animimic_fit::{FitError, Preset, reference};
use animimic_scene::{Asset, Camera, Cues, Image, Motion, Tracks, Video};
use animimic_video::cues::{self, Background};
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::time::Instant;

/// What stage 1 found.
pub struct Solved {
    pub motion: Motion,
    pub losses: Vec<LossCurve>,
    pub uncertain: Vec<String>,
    /// How well each part is known; empty where that was not estimated.
    pub certainty: Vec<Certainty>,
    /// Wall time of each part of the fit [s], in order; parts may come back.
    pub seconds: Vec<(&'static str, f64)>,
}

/// What motion is found from.
pub struct Scene<'a> {
    /// The rigged model.
    pub asset: &'a Asset,
    /// Its skeleton was made from the shape alone.
    pub made_rig: bool,
    /// The video's camera.
    pub camera: &'a Camera,
    /// The video.
    pub video: &'a Video,
    /// Its cues.
    pub cues: &'a Cues,
    /// What is behind the object.
    pub background: &'a Background,
}

impl<'a> Scene<'a> {
    /// What is behind the object \[frame\].
    pub fn backgrounds(&self) -> Vec<Image> {
        let frames = self.video.frames.par_iter().enumerate();
        frames.map(|(t, frame)| background_picture(self.background, frame, t)).collect()
    }

    /// What stage 1 looks at, over the backgrounds \[frame\].
    pub fn input(&self, backgrounds: &'a [Image]) -> Input<'a> {
        Input {
            asset: self.asset,
            camera: self.camera,
            frames: &self.video.frames,
            masks: &self.cues.masks,
            backgrounds,
            flow: &dense_flow,
            tracks: Some(&self.cues.tracks).filter(|t| !t.query_frame.is_empty()),
            depth: &self.cues.depth,
            depth_kind: self.cues.depth_kind,
        }
    }
}

/// Frames that look this unlike the video (mean colour difference over the object, with a penalty where only one of both
/// shows it) are reported.
const UNLIKE: f64 = 0.08;

/// Finds the motion in a video; `keeper` keeps the steps of the default way.
pub fn find(
    scene: &Scene,
    preset: Preset,
    name: &str,
    keeper: &mut dyn Keeper,
    progress: &mut Progress,
) -> Result<Solved, Error> {
    let backgrounds = scene.backgrounds();
    let input = scene.input(&backgrounds);
    match preset {
        Preset::Default => {
            let settings = if scene.made_rig { Settings::default().for_made_rig() } else { Settings::default() };
            by_default(&input, settings, scene.video.fps, name, keeper, progress)
        }
        Preset::Reference => {
            let tracks = own_tracks(scene);
            by_reference(&Input { tracks: input.tracks.or(Some(&tracks)), ..input }, scene.video.fps, name, progress)
        }
    }
}

/// Point tracks of the embedded tracker.
fn own_tracks(scene: &Scene) -> Tracks {
    cues::tracks(scene.video, &scene.cues.masks, &cues::TrackOptions::default())
}

/// Time spent in each part, in order; a part that is entered again is there again.
struct Stopwatch {
    running: (&'static str, Instant),
    seconds: Vec<(&'static str, f64)>,
}

impl Stopwatch {
    fn new(first: &'static str) -> Self {
        Self { running: (first, Instant::now()), seconds: Vec::new() }
    }

    /// Another part begins, or the same goes on.
    fn enter(&mut self, part: &'static str) {
        if part == self.running.0 {
            return;
        }
        let (name, since) = std::mem::replace(&mut self.running, (part, Instant::now()));
        self.seconds.push((name, since.elapsed().as_secs_f64()));
    }

    fn stop(mut self) -> Vec<(&'static str, f64)> {
        self.enter("");
        self.seconds
    }
}

fn by_default(
    input: &Input,
    settings: Settings,
    fps: f64,
    name: &str,
    keeper: &mut dyn Keeper,
    progress: &mut Progress,
) -> Result<Solved, Error> {
    let mut watch = Stopwatch::new(stage1::Phase::Track.name());
    let mut step = |phase: stage1::Phase, done: f64| -> ControlFlow<()> {
        watch.enter(phase.name());
        progress(Event::Step { done, loss: None })
    };
    let outcome = stage1::fit(input, settings, name, fps, keeper, &mut step)?;
    let unlike = outcome.mismatch.iter().filter(|m| **m > UNLIKE).count();
    let mut uncertain = Vec::new();
    if unlike > 0 {
        uncertain.push(format!("motion: {unlike} of {} frames do not look like the video", input.frames.len()));
    }
    if outcome.not_finite > 0 {
        let count = outcome.not_finite;
        uncertain.push(format!("motion: the energy was not a number {count} times; the best before each was kept"));
    }
    let mut losses = vec![LossCurve::new("joint solve of all frames", outcome.energies)];
    losses.extend(outcome.curves.into_iter().map(|c| LossCurve::new(&format!("polish: {}", c.name), c.values)));
    losses.push(LossCurve::new("unlikeness per frame", outcome.mismatch));
    Ok(Solved { motion: outcome.motion, losses, uncertain, certainty: outcome.certainty, seconds: watch.stop() })
}

fn by_reference(input: &Input, fps: f64, name: &str, progress: &mut Progress) -> Result<Solved, Error> {
    let watch = Stopwatch::new("reference");
    let subject = Subject::new(input.asset).map_err(FitError::from)?;
    let light = stage1::first_light(input, &subject)?;
    let kinematics = reference::free(&subject.tree.kinematics);
    let loss = reference::Loss::new(input, &subject, &kinematics, &light);
    let mut step = |done: f64, loss: Option<f64>| -> ControlFlow<()> { progress(Event::Step { done, loss }) };
    let run = reference::run(&loss, input.frames.len(), &reference::Schedule::default(), &mut step)?;
    let poses = run.poses.iter().map(|f| subject.file_pose(f)).collect();
    let mut losses = vec![LossCurve::new("total loss, all frames together", run.losses)];
    losses.extend(run.parts.into_iter().map(|c| LossCurve::new(&format!("loss: {}", c.name), c.values)));
    Ok(Solved {
        motion: Motion { name: name.into(), fps, poses },
        losses,
        uncertain: Vec::new(),
        certainty: Vec::new(),
        seconds: watch.stop(),
    })
}

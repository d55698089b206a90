//! Hands a take to stage 1 and says in words what the fit was unsure of.

use super::LossCurve;
use crate::Error;
use crate::cues::dense_flow;
use crate::event::{Event, Progress};
use crate::pictures::background_picture;
use animimic_fit::stage1::{self, Settings};
use animimic_scene::{Asset, Camera, Cues, Image, Motion, Video};
use animimic_video::cues::Background;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// What stage 1 found.
pub struct Solved {
    pub motion: Motion,
    pub losses: Vec<LossCurve>,
    pub uncertain: Vec<String>,
}

/// Frames that look this unlike the video (mean colour difference over the object, with a penalty where only one of both
/// shows it) are reported.
const UNLIKE: f64 = 0.08;

/// Finds the motion in a video.
pub fn find(
    asset: &Asset,
    camera: &Camera,
    cues: &Cues,
    background: &Background,
    video: &Video,
    name: &str,
    progress: &mut Progress,
) -> Result<Solved, Error> {
    let backgrounds: Vec<Image> =
        (0..video.frames.len()).into_par_iter().map(|t| background_picture(background, &video.frames[t], t)).collect();
    let input = stage1::Input {
        asset,
        camera,
        frames: &video.frames,
        masks: &cues.masks,
        backgrounds: &backgrounds,
        flow: &dense_flow,
        tracks: Some(&cues.tracks).filter(|t| !t.query_frame.is_empty()),
        depth: &cues.depth,
        depth_kind: cues.depth_kind,
    };
    let mut step = |done: f64| -> ControlFlow<()> { progress(Event::Step { done, loss: None }) };
    let outcome = stage1::fit(&input, Settings::default(), name, video.fps, &mut step)?;
    let unlike = outcome.mismatch.iter().filter(|m| **m > UNLIKE).count();
    let mut uncertain = Vec::new();
    if unlike > 0 {
        uncertain.push(format!("motion: {unlike} of {} frames do not look like the video", video.frames.len()));
    }
    let losses = vec![
        LossCurve { stage: "joint solve of all frames".into(), values: outcome.energies },
        LossCurve { stage: "unlikeness per frame".into(), values: outcome.mismatch },
    ];
    Ok(Solved { motion: outcome.motion, losses, uncertain })
}

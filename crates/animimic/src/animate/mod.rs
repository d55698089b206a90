//! The whole way: model and videos in; animated GLB, videos to look at and a report out.
//!
//! read → rig, if there is none → cues → camera → motion → export → pictures → metrics. Everything is computed before the
//! first file is written, and every file appears whole or not at all.

mod certainty;
mod chart;
mod deliver;
mod fit;
mod html;
mod motion;
mod options;
mod report;
mod residual;
mod sheet;

pub use certainty::PartCertainty;
pub use fit::fit;
pub use options::Job;
pub use report::{ClipReport, LossCurve, Report};

pub(crate) use residual::heat_map;

use crate::camera::{self, CameraChoice};
use crate::cues::Given;
use crate::event::{Event, Progress, tell};
use crate::{Against, Error, evaluate, rigging};
use animimic_fit::stage1::Certainty;
use animimic_rig::proxy;
use animimic_scene::{Asset, CameraFile, Cues, Motion, Trajectory, Video, io};
use animimic_video::cues;
use std::path::PathBuf;
use std::time::Instant;

/// One video with all that was found out about it.
pub(crate) struct Take {
    pub name: String,
    pub video: Video,
    pub cues: Cues,
    pub background: cues::Background,
    pub mask_confidence: Vec<f32>,
    pub camera: CameraFile,
    pub motion: Motion,
    /// Where the surface goes beyond the skin; `None` where it does not.
    pub trajectory: Option<Trajectory>,
    pub losses: Vec<LossCurve>,
    pub uncertain: Vec<String>,
    pub certainty: Vec<Certainty>,
}

/// The model, and what of it is drawn, solved and measured: itself, or a coarse stand-in for a dense mesh.
#[derive(Clone, Copy)]
struct Model<'a> {
    asset: &'a Asset,
    solved: &'a Asset,
}

/// Triangles of the stand-in: at working size more of them are smaller than a pixel.
const PROXY_TRIANGLES: usize = 20_000;

/// Wall time of each stage, in order.
#[derive(Default)]
pub(crate) struct Clock {
    pub stages: Vec<(String, f64)>,
}

impl Clock {
    /// Runs one stage and adds its time to the entry of that name.
    fn time<T>(&mut self, name: &str, work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
        let start = Instant::now();
        let out = work();
        self.add(name, start.elapsed().as_secs_f64());
        out
    }

    fn add(&mut self, name: &str, secs: f64) {
        match self.stages.iter_mut().find(|s| s.0 == name) {
            Some(s) => s.1 += secs,
            None => self.stages.push((name.to_owned(), secs)),
        }
    }

    fn to_json(&self) -> serde_json::Value {
        self.stages.iter().map(|(k, v)| (k.clone(), (*v).into())).collect::<serde_json::Map<_, _>>().into()
    }
}

/// Does a whole job and writes its files into `job.out`.
///
/// # Errors
/// Anything that is wrong with the inputs, before anything is written; [`Error::Cancelled`] when `progress` says stop.
pub fn animate(job: &Job, progress: &mut Progress) -> Result<Report, Error> {
    let mut clock = Clock::default();
    job.check()?;
    if job.out.is_file() {
        return Err(Error::Input(format!("{}: is a file, the results need a folder", job.out.display())));
    }
    let (asset, takes, mut report) = solve(job, &mut clock, progress)?;
    deliver::write(job, &asset, &takes, &mut report, &mut clock, progress)?;
    Ok(report)
}

/// Finds the motion in every video and measures it.
fn solve(job: &Job, clock: &mut Clock, progress: &mut Progress) -> Result<(Asset, Vec<Take>, Report), Error> {
    tell(progress, Event::Stage { name: "reading" })?;
    let mut asset = clock.time("read", || read_model(job))?;
    tell(progress, Event::Stage { name: "rigging" })?;
    let rig = clock.time("rig", || rigging::choose(&mut asset, &job.model, &job.rig))?;
    for warning in &asset.warnings {
        tell(progress, Event::Warning(warning.clone()))?;
    }
    let stand_in = clock.time("read", || Ok(proxy(&asset, PROXY_TRIANGLES)))?;
    let model = Model { asset: &asset, solved: stand_in.as_ref().unwrap_or(&asset) };
    let names = job.clip_names();
    let mut takes = Vec::new();
    for (index, name) in names.into_iter().enumerate() {
        takes.push(take(job, model, index, name, clock, progress)?);
    }
    let mut clips = Vec::new();
    for take in &takes {
        tell(progress, Event::Stage { name: "measuring" })?;
        clips.push(clock.time("metrics", || clip_report(model.solved, take))?);
    }
    let report = Report::new(job, &asset, rig, clips);
    Ok((asset, takes, report))
}

fn read_model(job: &Job) -> Result<Asset, Error> {
    Ok(io::read_with(&job.model, &io::ReadOptions { repair: job.repair })?)
}

/// Reads video number `index`, finds its cues, its camera and the motion in it.
fn take(
    job: &Job,
    model: Model,
    index: usize,
    name: String,
    clock: &mut Clock,
    progress: &mut Progress,
) -> Result<Take, Error> {
    tell(progress, Event::Stage { name: "reading" })?;
    let read = animimic_video::ReadOptions {
        working_height: Some(job.height_px),
        frames: job.frames.clone(),
        ..Default::default()
    };
    let video = clock.time("read", || Ok(animimic_video::read(&job.videos[index], &read)?))?;
    for warning in &video.warnings {
        tell(progress, Event::Warning(format!("{name}: {warning}")))?;
    }
    tell(progress, Event::Stage { name: "masks" })?;
    let given = Given {
        masks: job.masks.get(index).map(PathBuf::as_path),
        tracks: job.tracks.get(index).map(PathBuf::as_path),
        depth: job.depth.get(index).map(PathBuf::as_path),
        depth_kind: job.depth_kind,
    };
    let mut found = clock.time("masks", || crate::cues::find(&video, &given))?;
    tell(progress, Event::Stage { name: "camera" })?;
    let camera = clock.time("camera", || choose_camera(job, model, &video, &found.cues, &found.background))?;
    if given.masks.is_none() {
        let rest = &model.solved.rig;
        let rest = rest.at_rest();
        let silhouette = crate::pictures::silhouette(&camera.main, &model.solved.mesh, &rest);
        clock.time("masks", || crate::cues::refine_masks(&video, &silhouette, &mut found))?;
    }
    tell(progress, Event::Stage { name: "motion" })?;
    let scene = motion::Scene {
        asset: model.solved,
        camera: &camera.main,
        video: &video,
        cues: &found.cues,
        background: &found.background,
    };
    let solved = motion::find(&scene, job.preset, &name, progress)?;
    solved.seconds.iter().for_each(|(part, secs)| clock.add(&format!("motion: {part}"), *secs));
    Ok(Take {
        name,
        video,
        cues: found.cues,
        background: found.background,
        mask_confidence: found.mask_confidence,
        camera,
        motion: solved.motion,
        trajectory: None,
        losses: solved.losses,
        uncertain: solved.uncertain,
        certainty: solved.certainty,
    })
}

fn choose_camera(
    job: &Job,
    model: Model,
    video: &Video,
    found: &Cues,
    background: &cues::Background,
) -> Result<CameraFile, Error> {
    let (width, height) = (video.frames[0].width as u32, video.frames[0].height as u32);
    let (low, high) = model.asset.mesh.bounds();
    let file = |main| CameraFile { main, fps: video.fps, views: Vec::new(), target: Some(0.5 * (low + high)) };
    match &job.camera {
        CameraChoice::File(path) => Ok(CameraFile { fps: video.fps, ..camera::from_file(path, width, height)? }),
        CameraChoice::Preset(name) => Ok(file(camera::preset(name, (low, high), width, height)?)),
        CameraChoice::Auto => {
            Ok(file(camera::find(model.solved, &video.frames[0], &found.masks[0], background)?.camera))
        }
    }
}

fn clip_report(asset: &Asset, take: &Take) -> Result<ClipReport, Error> {
    let against = Against {
        input: Some(asset),
        camera: Some(take.camera.main),
        video: &take.video.frames,
        masks: &take.cues.masks,
        background: Some(&take.background),
        ..Against::default()
    };
    let evaluation = evaluate(asset, &take.motion.poses, take.motion.fps, &against)?;
    Ok(ClipReport::new(take, &asset.rig.skeleton, &evaluation))
}

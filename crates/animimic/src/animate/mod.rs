//! The whole way: model and videos in; animated GLB, videos to look at and a report out.
//!
//! read → rig, if there is none → cues → camera → motion → soft tissue → export → pictures → metrics. Everything is computed before
//! the first result is written, and every file appears whole or not at all; what each stage found is kept ([`crate::run`]).

mod certainty;
mod chart;
mod deliver;
mod fit;
mod html;
mod kept;
mod keys;
pub(crate) mod motion;
mod options;
mod report;
mod residual;
mod sheet;
mod soft;

pub use certainty::PartCertainty;
pub use fit::fit;
pub use options::{Flesh, Job, Stage};
pub use report::{ClipReport, LossCurve, Report};

pub(crate) use residual::heat_map;

use crate::camera::{self, CameraChoice};
use crate::cues::Given;
use crate::event::{Event, Progress, tell};
use crate::run::{Checkpoints, Key, Run, memory, safe};
use crate::{Against, Error, evaluate, rigging};
use animimic_fit::stage1::Certainty;
use animimic_rig::proxy;
use animimic_scene::{Asset, CameraFile, Cues, Mask, Motion, Video, io};
use animimic_video::cues;
use kept::Seen;
use std::cell::OnceCell;
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
    /// The soft surface \[frame\]\[vertex\], also where it is not kept; empty where it was not asked for.
    pub soft: Vec<Vec<glam::DVec3>>,
    /// Whether it is the result: whether the frames speak for it.
    pub soft_kept: bool,
    /// What the frames said of the soft surface; null where they were not asked.
    pub softness: serde_json::Value,
    pub losses: Vec<LossCurve>,
    pub uncertain: Vec<String>,
    pub certainty: Vec<Certainty>,
    /// Memory that finding the motion was estimated to take [bytes].
    pub memory_bytes: u64,
}

/// The model, and what of it is drawn, solved and measured: itself, or a coarse stand-in for a dense mesh.
#[derive(Clone, Copy)]
pub(crate) struct Model<'a> {
    pub asset: &'a Asset,
    pub solved: &'a Asset,
    /// The skeleton was made from the shape alone.
    pub made_rig: bool,
}

impl<'a> Model<'a> {
    /// The model with its stand-in, if it has one.
    pub fn new(asset: &'a Asset, stand_in: &'a Option<Asset>, made_rig: bool) -> Self {
        Self { asset, solved: stand_in.as_ref().unwrap_or(asset), made_rig }
    }
}

/// Triangles of the stand-in: at working size more of them are smaller than a pixel.
pub(crate) const PROXY_TRIANGLES: usize = 20_000;

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

/// All that is known before the first result is written.
struct Work {
    asset: Asset,
    takes: Vec<Take>,
    /// Young's modulus of the flesh at the surface [Pa], per vertex; empty where none was made.
    youngs: Vec<f32>,
    /// What all of it depends on.
    key: Key,
}

/// Does a whole job and writes its files into `job.out`.
///
/// # Errors
/// Anything that is wrong with the inputs, before any result is written; another run in the same folder; [`Error::Cancelled`] when
/// `progress` says stop, with all finished stages kept for [`Job::resume`].
pub fn animate(job: &Job, progress: &mut Progress) -> Result<Report, Error> {
    Ok(animated(job, progress)?.0)
}

/// The same; and whether all of it was there already.
pub(crate) fn animated(job: &Job, progress: &mut Progress) -> Result<(Report, bool), Error> {
    let mut clock = Clock::default();
    job.check()?;
    if job.out.is_file() {
        return Err(Error::Input(format!("{}: is a file, the results need a folder", job.out.display())));
    }
    let run = Run::begin(&job.out, job.resume)?;
    if let Some(report) = finished(job, &run, progress)? {
        return Ok((report, true));
    }
    let (work, mut report) = solve(job, &run, &mut clock, progress)?;
    let files = deliver::write(job, &work, &mut report, &mut clock, progress)?;
    run.finish(&job.out, &work.key, &files)?;
    Ok((report, false))
}

/// The report of an earlier run of the same job, if that finished and its files are as it left them.
fn finished(job: &Job, run: &Run, progress: &mut Progress) -> Result<Option<Report>, Error> {
    if !run.may_be_finished() {
        return Ok(None);
    }
    tell(progress, Event::Stage { name: "reading" })?;
    let mut asset = read_model(job)?;
    let rig = rigging::choose(&mut asset, &job.model, &job.rig)?;
    let model = keys::model(&asset, rig.made);
    let mut motions = Vec::new();
    for (index, name) in job.clip_names().iter().enumerate() {
        motions.push(keys::motion(job, name, &keys::seen(job, index, &model, &read_video(job, index)?)?));
    }
    if !run.is_finished(&job.out, &keys::whole(job, &motions)) {
        return Ok(None);
    }
    let path = job.out.join("report.json");
    let text = std::fs::read(&path).map_err(Error::io(&path))?;
    Ok(serde_json::from_slice(&text).ok())
}

/// Finds the motion in every video and measures it.
fn solve(job: &Job, run: &Run, clock: &mut Clock, progress: &mut Progress) -> Result<(Work, Report), Error> {
    tell(progress, Event::Stage { name: "reading" })?;
    let mut asset = clock.time("read", || read_model(job))?;
    tell(progress, Event::Stage { name: "rigging" })?;
    let rig = clock.time("rig", || rigging::choose(&mut asset, &job.model, &job.rig))?;
    for warning in &asset.warnings {
        tell(progress, Event::Warning(warning.clone()))?;
    }
    let stand_in = clock.time("read", || Ok(proxy(&asset, PROXY_TRIANGLES)))?;
    let model = Model::new(&asset, &stand_in, rig.made);
    // Hashed when the first video is read: bad inputs are refused before.
    let key = OnceCell::new();
    let names = job.clip_names();
    let (mut takes, mut motions) = (Vec::new(), Vec::new());
    for (index, name) in names.into_iter().enumerate() {
        let (take, key) = take(job, run, model, &key, index, name, clock, progress)?;
        takes.push(take);
        motions.push(key);
    }
    let (material, youngs) = match job.stage {
        Stage::Pose => Default::default(),
        Stage::Soft => {
            let key = keys::soft(job, &motions);
            clock.time("soft tissue", || soft::refine(job, run, &key, model, &mut takes, progress))?
        }
    };
    let mut clips = Vec::new();
    for take in &takes {
        tell(progress, Event::Stage { name: "measuring" })?;
        clips.push(clock.time("metrics", || clip_report(model.solved, take))?);
    }
    let report = Report { material, ..Report::new(job, &asset, rig.words, clips) };
    let key = keys::whole(job, &motions);
    Ok((Work { asset, takes, youngs, key }, report))
}

fn read_model(job: &Job) -> Result<Asset, Error> {
    Ok(io::read_with(&job.model, &io::ReadOptions { repair: job.repair })?)
}

fn read_video(job: &Job, index: usize) -> Result<Video, Error> {
    let read = animimic_video::ReadOptions {
        working_height: Some(job.height_px),
        frames: job.frames.clone(),
        ..Default::default()
    };
    Ok(animimic_video::read(&job.videos[index], &read)?)
}

/// Reads video number `index`, finds its cues, its camera and the motion in it; and what that depends on.
fn take(
    job: &Job,
    run: &Run,
    model: Model,
    key: &OnceCell<Key>,
    index: usize,
    name: String,
    clock: &mut Clock,
    progress: &mut Progress,
) -> Result<(Take, Key), Error> {
    let video = watch(job, index, &name, clock, progress)?;
    let memory_bytes = memory::needed(model.asset, &video);
    if let Some(warning) = memory::check(&name, memory_bytes, video.frames.len())? {
        tell(progress, Event::Warning(warning))?;
    }
    let key = keys::seen(job, index, key.get_or_init(|| keys::model(model.asset, model.made_rig)), &video)?;
    let Seen { found, camera } = run.kept(&format!("{}.cues", safe(&name)), &key, || {
        let seen = see(job, model, index, &video, clock, progress)?;
        belong_together(job, index, model, &seen)?;
        Ok(seen)
    })?;
    tell(progress, Event::Stage { name: "motion" })?;
    let key = keys::motion(job, &name, &key);
    let scene = motion::Scene {
        asset: model.solved,
        made_rig: model.made_rig,
        camera: &camera.main,
        video: &video,
        cues: &found.cues,
        background: &found.background,
    };
    let mut steps = Checkpoints::new(run, &name, &key);
    let solved = run.kept(&format!("{}.motion", safe(&name)), &key, || {
        motion::find(&scene, job.preset, &name, &mut steps, progress)
    })?;
    steps.forget();
    solved.seconds.iter().for_each(|(part, secs)| clock.add(&format!("motion: {part}"), *secs));
    let take = Take {
        name,
        video,
        cues: found.cues,
        background: found.background,
        mask_confidence: found.mask_confidence,
        camera,
        motion: solved.motion,
        soft: Vec::new(),
        soft_kept: false,
        softness: serde_json::Value::Null,
        losses: solved.losses,
        uncertain: solved.uncertain,
        certainty: solved.certainty,
        memory_bytes,
    };
    Ok((take, key))
}

/// A video, its cues and its camera, for others than a job of its own.
pub(crate) fn footage(job: &Job, model: Model, name: &str, progress: &mut Progress) -> Result<(Video, Seen), Error> {
    let mut clock = Clock::default();
    let video = watch(job, 0, name, &mut clock, progress)?;
    let seen = see(job, model, 0, &video, &mut clock, progress)?;
    Ok((video, seen))
}

/// Reads video number `index` and tells what is odd about it.
fn watch(job: &Job, index: usize, name: &str, clock: &mut Clock, progress: &mut Progress) -> Result<Video, Error> {
    tell(progress, Event::Stage { name: "reading" })?;
    let video = clock.time("read", || read_video(job, index))?;
    for warning in &video.warnings {
        tell(progress, Event::Warning(format!("{name}: {warning}")))?;
    }
    Ok(video)
}

/// Finds the cues in a video and its camera.
fn see(
    job: &Job,
    model: Model,
    index: usize,
    video: &Video,
    clock: &mut Clock,
    progress: &mut Progress,
) -> Result<Seen, Error> {
    tell(progress, Event::Stage { name: "masks" })?;
    let given = Given {
        masks: job.masks.get(index),
        tracks: job.tracks.get(index).map(PathBuf::as_path),
        depth: job.depth.get(index),
        depth_kind: job.depth_kind,
    };
    let mut found = clock.time("masks", || crate::cues::find(video, &given))?;
    tell(progress, Event::Stage { name: "camera" })?;
    let camera = clock.time("camera", || choose_camera(job, index, model, video, &found.cues, &found.background))?;
    if given.masks.is_none() {
        let silhouette = silhouette(model, &camera);
        clock.time("masks", || crate::cues::refine_masks(video, &silhouette, &mut found))?;
    }
    Ok(Seen { found, camera })
}

/// Of the model as it stands.
fn silhouette(model: Model, camera: &CameraFile) -> Mask {
    crate::pictures::silhouette(&camera.main, &model.solved.mesh, &model.solved.rig.at_rest())
}

/// Below this overlap of the model as it stands and the object in frame 0, the run would show nothing but that something is wrong. Clips
/// that begin in another pose than the model's still overlap by two thirds and more.
const LEAST_OVERLAP: f64 = 0.3;

/// Refuses a camera that shows the model beside the object.
fn belong_together(job: &Job, index: usize, model: Model, seen: &Seen) -> Result<(), Error> {
    let overlap = silhouette(model, &seen.camera).iou(&seen.found.cues.masks[0]);
    if overlap >= LEAST_OVERLAP {
        return Ok(());
    }
    let (video, camera) = (job.videos[index].display(), &job.camera);
    Err(Error::Input(format!(
        "{video}: with the camera {camera} the model overlaps the object of the first frame by only {overlap:.2}: camera, model and video \
         do not belong together; --camera auto looks for a camera"
    )))
}

fn choose_camera(
    job: &Job,
    index: usize,
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
            let found = camera::find(model.solved, &video.frames[0], &found.masks[0], background);
            Ok(file(found.map_err(|e| Error::Input(format!("{}: {e}", job.videos[index].display())))?.camera))
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

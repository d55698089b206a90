//! Soft tissue for an animation that is there already: stiffness chosen by hand, or learnt from a video of the clip.
//!
//! read → cage → simulate → give way → export → pictures → report. Everything is computed before the first file is written.

pub(crate) mod body;
mod circles;
mod deliver;
pub(crate) mod filmed;
pub mod softness;
pub mod yielding;

pub use softness::{PRESETS, Softness, young};

use crate::animate::motion::Scene;
use crate::animate::{Job, Model, PROXY_TRIANGLES, footage};
use crate::camera::CameraChoice;
use crate::event::{Event, Progress, tell};
use crate::{Error, Physics};
use animimic_fit::soft::{Settings, Stepping, Tissue};
use animimic_scene::io::gltf::Clip;
use animimic_scene::{Asset, Motion, io};
use animimic_sim::tet::DEFAULT_TETS;
use body::Softened;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A model with a clip, and how soft it shall be.
#[derive(Clone, Debug)]
pub struct Soften {
    /// The animated model.
    pub model: PathBuf,
    /// Folder for the results; made if absent.
    pub out: PathBuf,
    /// A video that shows the clip: the stiffness is then learnt from it.
    pub video: Option<PathBuf>,
    /// Its camera.
    pub camera: CameraChoice,
    /// Name of the clip; the first where absent.
    pub clip: Option<String>,
    /// Stiffness, for all or by material; later entries count more.
    pub softness: Vec<Softness>,
    /// About how many tets.
    pub tets: usize,
    /// Length of the rest diagonal [m].
    pub size_m: f64,
    /// Names of joints that do not hold what hangs on them.
    pub loose: Vec<String>,
    /// Damping proportional to mass [1/s].
    pub damping: f64,
    /// Frames per second at which the clip is sampled and simulated.
    pub fps: f64,
    /// How the soft motion is written.
    pub physics: Physics,
    /// Height of each view [px].
    pub height_px: usize,
    /// Mend what is broken in small ways (indices and joints out of range, values that are not finite) instead of refusing.
    pub repair: bool,
}

impl Soften {
    /// A job with the defaults.
    pub fn new(model: impl Into<PathBuf>, out: impl Into<PathBuf>) -> Self {
        Self {
            model: model.into(),
            out: out.into(),
            video: None,
            camera: CameraChoice::Auto,
            clip: None,
            softness: Vec::new(),
            tets: DEFAULT_TETS,
            size_m: 1.0,
            loose: Vec::new(),
            damping: 0.0,
            fps: 30.0,
            physics: Physics::default(),
            height_px: 512,
            repair: false,
        }
    }

    fn check(&self) -> Result<(), Error> {
        if self.out.is_file() {
            return Err(Error::Input(format!("{}: is a file, the results need a folder", self.out.display())));
        }
        let sound = self.fps > 0.0 && self.fps <= 240.0 && (16..=2160).contains(&self.height_px);
        if !sound || !(0.0..=1e4).contains(&self.damping) {
            return Err(Error::Input(
                "use 1 to 240 frames per second, views of 16 to 2160 px and a damping of 0 to 10000 per second".into(),
            ));
        }
        Ok(())
    }
}

/// Gives a clip of an animated model soft tissue; writes `softened.glb`, `views.mp4` (skinning and soft side by side) and
/// `report.json` into the folder `job.out`, and returns the report.
///
/// # Errors
/// Anything that is wrong with the inputs, before anything is written; [`Error::Cancelled`] when `progress` says stop.
pub fn soften(job: &Soften, progress: &mut Progress) -> Result<serde_json::Value, Error> {
    job.check()?;
    tell(progress, Event::Stage { name: "reading" })?;
    let asset = io::read_with(&job.model, &io::ReadOptions { repair: job.repair })?;
    for warning in &asset.warnings {
        tell(progress, Event::Warning(warning.clone()))?;
    }
    let clip = crate::measure::clip(&asset, &job.model, job.clip.as_deref())?;
    let (softened, material) = match &job.video {
        Some(video) => learnt(job, &asset, &clip, video, progress)?,
        None => (simulate(job, &asset, clip.motion(&asset.rig.skeleton, job.fps)?, progress)?, Value::Null),
    };
    tell(progress, Event::Stage { name: "writing" })?;
    deliver::write(job, &asset, &softened, material, progress)
}

/// Soft tissue of a stiffness that is learnt from a video of the clip.
fn learnt(
    job: &Soften,
    asset: &Asset,
    clip: &Clip,
    video: &Path,
    progress: &mut Progress,
) -> Result<(Softened, Value), Error> {
    let stand_in = animimic_rig::proxy(asset, PROXY_TRIANGLES);
    let model = Model::new(asset, &stand_in, false);
    let filming = Job { camera: job.camera.clone(), ..Job::new(&job.model, vec![video.to_owned()], &job.out) };
    let (mut film, mut seen) = footage(&filming, model, &clip.name, progress)?;
    let mut motion = clip.motion(&asset.rig.skeleton, film.fps)?;
    let frames = motion.poses.len().min(film.frames.len());
    if frames < 2 {
        return Err(Error::Input(format!(
            "{}: the clip and the video have {frames} frames in common",
            video.display()
        )));
    }
    motion.poses.truncate(frames);
    film.frames.truncate(frames);
    seen.found.cues.masks.truncate(frames);
    let scene = Scene {
        asset: model.solved,
        made_rig: false,
        camera: &seen.camera.main,
        video: &film,
        cues: &seen.found.cues,
        background: &seen.found.background,
    };
    let stiffness = job.softness.iter().rfind(|s| s.material.is_none()).map_or(PRESETS[0].1, |s| s.young);
    let settings = settings(asset, job.tets, job.size_m, &job.loose)?;
    let takes = [filmed::Filmed { scene, motion: &motion }];
    let ask = filmed::Ask { settings, young: stiffness, solve: false };
    let (mut outcomes, material) = filmed::refine(asset, model.solved, &takes, &ask, progress)?;
    let filmed::Outcome { softened, mut report, .. } = outcomes.pop().expect("one clip went in");
    report["material"] = material;
    Ok((softened, report))
}

/// How tissue is made: about `tets` tets, a rest diagonal of `size_m`, joints of these names loose.
pub(crate) fn settings(asset: &Asset, tets: usize, size_m: f64, loose: &[String]) -> Result<Settings, Error> {
    Ok(Settings { tets, size_m, loose: joints(asset, loose)?, ..Settings::default() })
}

fn simulate(job: &Soften, asset: &Asset, motion: Motion, progress: &mut Progress) -> Result<Softened, Error> {
    tell(progress, Event::Stage { name: "tetrahedra" })?;
    let tissue = Tissue::new(asset, &settings(asset, job.tets, job.size_m, &job.loose)?)?;
    let elasticity = softness::elasticity(asset, &tissue, &job.softness)?;
    let tissue = tissue.holding(&elasticity);
    tell(progress, Event::Stage { name: "simulating" })?;
    let stepping = Stepping { mass_damping: job.damping, ..Stepping::default() };
    let mut softened = body::soften(&tissue, &elasticity, &stepping, &motion)?;
    tell(progress, Event::Stage { name: "self-intersections" })?;
    softened.uncross(&tissue);
    Ok(softened)
}

/// Joints by name.
fn joints(asset: &Asset, names: &[String]) -> Result<Vec<usize>, Error> {
    let all = &asset.rig.skeleton.joints;
    let find = |name: &String| {
        all.iter().position(|j| j.name == *name).ok_or_else(|| {
            let known: Vec<&str> = all.iter().map(|j| j.name.as_str()).collect();
            Error::Input(format!("no joint named {name}: there are {}", known.join(", ")))
        })
    };
    names.iter().map(find).collect()
}

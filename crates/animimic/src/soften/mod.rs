//! Soft tissue for an animation that is there already: no video, stiffness chosen by hand.
//!
//! read → cage → simulate → give way → export → pictures → report. Everything is computed before the first file is written.

mod deliver;
pub mod softness;
pub mod yielding;

pub use softness::{PRESETS, Softness};

use crate::event::{Event, Progress, tell};
use crate::{Error, Physics};
use animimic_fit::soft::{Report as Simulation, Settings, Stepping, Tissue};
use animimic_scene::{Asset, Motion, Refined, Trajectory, io};
use animimic_sim::tet::DEFAULT_TETS;
use glam::DVec3;
use rayon::prelude::*;
use std::path::PathBuf;
use std::time::Instant;
use yielding::{Yielded, give_way};

/// A model with a clip, and how soft it shall be.
#[derive(Clone, Debug)]
pub struct Soften {
    /// The animated model.
    pub model: PathBuf,
    /// Folder for the results; made if absent.
    pub out: PathBuf,
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

/// A clip with soft tissue.
pub(crate) struct Softened {
    pub motion: Motion,
    /// Surfaces \[frame\]\[vertex\].
    pub skinned: Vec<Vec<DVec3>>,
    pub soft: Vec<Vec<DVec3>>,
    pub simulation: Simulation,
    pub yielded: Yielded,
    pub tets: usize,
    /// Wall time of the forward simulation [s].
    pub simulated_s: f64,
}

impl Softened {
    fn refined(&self) -> Refined {
        let trajectory = Trajectory { fps: self.motion.fps, frames: self.soft.clone() };
        Refined { motion: self.motion.clone(), trajectory: Some(trajectory) }
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
    let motion = crate::measure::clip(&asset, &job.model, job.clip.as_deref())?.motion(&asset.rig.skeleton, job.fps)?;
    let softened = simulate(job, &asset, motion, progress)?;
    tell(progress, Event::Stage { name: "writing" })?;
    deliver::write(job, &asset, &softened, progress)
}

fn simulate(job: &Soften, asset: &Asset, motion: Motion, progress: &mut Progress) -> Result<Softened, Error> {
    tell(progress, Event::Stage { name: "tetrahedra" })?;
    let settings = Settings { tets: job.tets, size_m: job.size_m, loose: joints(asset, &job.loose)? };
    let tissue = Tissue::new(asset, &settings)?;
    let elasticity = softness::elasticity(asset, &tissue, &job.softness)?;
    tell(progress, Event::Stage { name: "simulating" })?;
    let clock = Instant::now();
    let stepping = Stepping { mass_damping: job.damping, ..Stepping::default() };
    let simulated = tissue.simulate(&elasticity, &stepping, &motion.poses, motion.fps)?;
    let simulated_s = clock.elapsed().as_secs_f64();
    let cages: Vec<&Vec<DVec3>> = simulated.frames().collect();
    let pairs: Vec<(Vec<DVec3>, Vec<DVec3>)> = (motion.poses.par_iter().zip(cages))
        .map(|(pose, cage)| {
            let world = tissue.world(pose);
            (asset.rig.skinned(&world), tissue.surface(cage, &world))
        })
        .collect();
    let (skinned, mut soft): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
    tell(progress, Event::Stage { name: "self-intersections" })?;
    let yielded = give_way(&asset.mesh, &skinned, &mut soft);
    let (simulation, tets) = (simulated.report, tissue.body.tets.len());
    Ok(Softened { motion, skinned, soft, simulation, yielded, tets, simulated_s })
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

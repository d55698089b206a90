//! Writes the files of a finished job.

use super::html::{self, Shown};
use super::sheet::Stage;
use super::{Clock, Job, Report, Take, Work};
use crate::Error;
use crate::event::{Event, Progress, tell};
use crate::film::film;
use crate::physics::{self, Delivery, Physics};
use crate::run::safe;
use animimic_scene::io::gltf::ExportOptions;
use animimic_scene::{Asset, Refined, Trajectory, io};
use animimic_video::write_png;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Names of a take's own files: plain for a single video, else with the clip's name.
struct Names {
    views: PathBuf,
    residuals: PathBuf,
    sheet: PathBuf,
    camera: PathBuf,
}

impl Names {
    fn new(folder: &Path, clip: Option<&str>) -> Self {
        let safe = clip.map(safe);
        let name = |stem: &str, end: &str| {
            folder.join(safe.as_ref().map_or_else(|| format!("{stem}.{end}"), |c| format!("{stem}-{c}.{end}")))
        };
        Self {
            views: name("views", "mp4"),
            residuals: name("residuals", "mp4"),
            sheet: name("contact_sheet", "png"),
            camera: name("camera", "json"),
        }
    }
}

/// Writes `animated.glb` and, where asked for, `soft.glb`, then for each take `views.mp4`, `residuals.mp4`, `contact_sheet.png` and
/// `camera.json`, then both reports; returns their paths.
pub(super) fn write(
    job: &Job,
    work: &Work,
    report: &mut Report,
    clock: &mut Clock,
    progress: &mut Progress,
) -> Result<Vec<PathBuf>, Error> {
    let (folder, Work { asset, takes, youngs, .. }) = (&job.out, work);
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    tell(progress, Event::Stage { name: "writing" })?;
    let soft = job.stage == super::Stage::Soft;
    // What goes beyond the skeleton goes with `soft.glb`.
    let physics = if soft { Physics::NONE } else { job.physics };
    let mut files = glb(&folder.join("animated.glb"), physics, asset, &skinned(takes), &[], report, clock)?;
    if soft {
        files.extend(glb(&folder.join("soft.glb"), job.physics, asset, &refined(takes), youngs, report, clock)?);
    }
    let mut shown = Vec::new();
    for take in takes {
        let names = Names::new(folder, (takes.len() > 1).then_some(take.name.as_str()));
        io::camera_json::write(&names.camera, &take.camera)?;
        shown.push(clock.time("pictures", || pictures(asset, take, &names, progress))?);
        files.extend([names.views, names.residuals, names.sheet, names.camera]);
    }
    report.timings = clock.to_json();
    let json = serde_json::to_string_pretty(report).expect("a report has string keys and finite numbers") + "\n";
    let page = html::page(report, &shown);
    for (name, text) in [("report.json", json), ("report.html", page)] {
        let path = folder.join(name);
        io::write_atomically(&path, |w| w.write_all(text.as_bytes()))?;
        files.push(path);
    }
    Ok(files)
}

/// The takes as the skeleton moves them.
pub fn skinned(takes: &[Take]) -> Vec<Refined> {
    takes.iter().map(|t| Refined { motion: t.motion.clone(), trajectory: None }).collect()
}

/// The takes with their soft surfaces.
fn refined(takes: &[Take]) -> Vec<Refined> {
    let surface = |t: &Take| t.soft_kept.then(|| Trajectory { fps: t.motion.fps, frames: t.soft.clone() });
    takes.iter().map(|t| Refined { motion: t.motion.clone(), trajectory: surface(t) }).collect()
}

/// Writes the model with a clip per take and the moduli of its flesh (none if empty), and what goes with it; what made it travels in the file, and what it lost in the report.
/// Returns the paths of all files.
pub fn glb(
    path: &Path,
    physics: Physics,
    asset: &Asset,
    clips: &[Refined],
    youngs: &[f32],
    report: &mut Report,
    clock: &mut Clock,
) -> Result<Vec<PathBuf>, Error> {
    let delivered = clock.time("export", || {
        let metrics: Vec<_> = report.clips.iter().map(|c| &c.metrics).collect();
        let extras = serde_json::json!({"program": report.program, "options": report.options, "metrics": metrics});
        let options = ExportOptions { youngs: youngs.to_vec(), extras, ..Default::default() };
        physics::deliver(physics, &Delivery { asset, clips, glb: path, options })
    })?;
    report.physics = delivered.to_json();
    Ok(delivered.files)
}

fn pictures(asset: &Asset, take: &Take, names: &Names, progress: &mut Progress) -> Result<Shown, Error> {
    let stage = Stage::new(asset, take)?;
    let length = (stage.frames(), take.motion.fps);
    film(&names.views, length, (0.0, 0.7), |t| stage.views(t), progress)?;
    film(&names.residuals, length, (0.7, 1.0), |t| stage.residuals(t), progress)?;
    write_png(&names.sheet, &stage.contact_sheet())?;
    let bytes = |path: &Path| std::fs::read(path).map_err(Error::io(path));
    let residuals = names.residuals.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Shown { views: bytes(&names.views)?, sheet: bytes(&names.sheet)?, residuals })
}

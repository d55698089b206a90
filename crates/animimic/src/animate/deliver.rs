//! Writes the files of a finished job.

use super::html::{self, Shown};
use super::sheet::Stage;
use super::{Clock, Job, Report, Take};
use crate::Error;
use crate::event::{Event, Progress, tell};
use crate::physics::{self, Delivery, Physics};
use animimic_scene::io::gltf::ExportOptions;
use animimic_scene::{Asset, Image, Refined, io};
use animimic_video::{write_mp4, write_png};
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
        let safe: Option<String> =
            clip.map(|c| c.chars().map(|c| if c.is_alphanumeric() || c == '-' { c } else { '_' }).collect());
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

/// Writes `animated.glb` and, where asked for, `soft.glb`, then for each take `views.mp4`, `residuals.mp4`, `contact_sheet.png` and `camera.json`, then both reports.
pub fn write(
    job: &Job,
    asset: &Asset,
    takes: &[Take],
    report: &mut Report,
    clock: &mut Clock,
    progress: &mut Progress,
) -> Result<(), Error> {
    let folder = &job.out;
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    tell(progress, Event::Stage { name: "writing" })?;
    glb(&folder.join("animated.glb"), job.physics, asset, &skinned(takes), report, clock)?;
    if job.stage == super::Stage::Soft {
        glb(&folder.join("soft.glb"), job.physics, asset, &refined(takes), report, clock)?;
    }
    let mut shown = Vec::new();
    for take in takes {
        let names = Names::new(folder, (takes.len() > 1).then_some(take.name.as_str()));
        io::camera_json::write(&names.camera, &take.camera)?;
        shown.push(clock.time("pictures", || pictures(asset, take, &names, progress))?);
    }
    report.timings = clock.to_json();
    let json = serde_json::to_string_pretty(report).expect("a report has string keys and finite numbers") + "\n";
    io::write_atomically(folder.join("report.json"), |w| w.write_all(json.as_bytes()))?;
    let page = html::page(report, &shown);
    io::write_atomically(folder.join("report.html"), |w| w.write_all(page.as_bytes()))?;
    Ok(())
}

/// The takes as the skeleton moves them.
pub fn skinned(takes: &[Take]) -> Vec<Refined> {
    takes.iter().map(|t| Refined { motion: t.motion.clone(), trajectory: None }).collect()
}

/// The takes with their soft surfaces.
fn refined(takes: &[Take]) -> Vec<Refined> {
    takes.iter().map(|t| Refined { motion: t.motion.clone(), trajectory: t.trajectory.clone() }).collect()
}

/// Writes the model with a clip per take, and what goes with it; what made it travels in the file, and what it lost in the report.
pub fn glb(
    path: &Path,
    physics: Physics,
    asset: &Asset,
    clips: &[Refined],
    report: &mut Report,
    clock: &mut Clock,
) -> Result<(), Error> {
    let delivered = clock.time("export", || {
        let metrics: Vec<_> = report.clips.iter().map(|c| &c.metrics).collect();
        let extras = serde_json::json!({"program": report.program, "options": report.options, "metrics": metrics});
        let options = ExportOptions { extras, ..Default::default() };
        physics::deliver(physics, &Delivery { asset, clips, glb: path, options })
    })?;
    report.physics = delivered.to_json();
    Ok(())
}

fn pictures(asset: &Asset, take: &Take, names: &Names, progress: &mut Progress) -> Result<Shown, Error> {
    let stage = Stage::new(asset, take)?;
    film(&stage, &names.views, (0.0, 0.7), take.motion.fps, |t| stage.views(t), progress)?;
    film(&stage, &names.residuals, (0.7, 1.0), take.motion.fps, |t| stage.residuals(t), progress)?;
    write_png(&names.sheet, &stage.contact_sheet())?;
    let bytes = |path: &Path| std::fs::read(path).map_err(Error::io(path));
    let residuals = names.residuals.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Shown { views: bytes(&names.views)?, sheet: bytes(&names.sheet)?, residuals })
}

/// Draws and writes a video; `share` is the part of the progress that it takes.
fn film(
    stage: &Stage,
    path: &Path,
    share: (f64, f64),
    fps: f64,
    draw: impl Fn(usize) -> Image,
    progress: &mut Progress,
) -> Result<(), Error> {
    let frames = stage.frames();
    let mut stop = Ok(());
    let mut drawn = (0..frames).map_while(|t| {
        let done = share.0 + (share.1 - share.0) * t as f64 / frames as f64;
        stop = tell(progress, Event::Step { done, loss: None });
        stop.is_ok().then(|| draw(t))
    });
    let written = write_mp4(path, &mut drawn, fps);
    if stop.is_err() {
        let _ = std::fs::remove_file(path);
        stop?;
    }
    Ok(written?)
}

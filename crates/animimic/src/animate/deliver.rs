//! Writes the files of a finished job.

use super::html::{self, Shown};
use super::sheet::Stage;
use super::{Clock, Job, Report, Take};
use crate::Error;
use crate::event::{Event, Progress, tell};
use animimic_scene::io::gltf::{ExportOptions, save_clips};
use animimic_scene::{Asset, Motion, io};
use animimic_video::{write_mp4, write_png};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Names of a take's own files: plain for a single video, else with the clip's name.
struct Names {
    views: PathBuf,
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
        Self { views: name("views", "mp4"), sheet: name("contact_sheet", "png"), camera: name("camera", "json") }
    }
}

/// Writes `animated.glb`, then for each take `views.mp4`, `contact_sheet.png` and `camera.json`, then both reports.
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
    clock.time("export", || {
        let motions: Vec<Motion> = takes.iter().map(|t| t.motion.clone()).collect();
        let metrics: Vec<_> = report.clips.iter().map(|c| &c.metrics).collect();
        let extras = serde_json::json!({"program": report.program, "options": report.options, "metrics": metrics});
        Ok(save_clips(folder.join("animated.glb"), asset, &motions, &ExportOptions { extras, ..Default::default() })?)
    })?;
    let mut shown = Vec::new();
    for take in takes {
        let names = Names::new(folder, (takes.len() > 1).then_some(take.name.as_str()));
        io::camera_json::write(&names.camera, &take.camera)?;
        shown.push(clock.time("pictures", || pictures(asset, take, &names, progress))?);
    }
    let timings = clock.stages.iter().map(|(k, v)| (k.clone(), (*v).into())).collect();
    report.timings = serde_json::Value::Object(timings);
    let json = serde_json::to_string_pretty(report).expect("a report has string keys and finite numbers") + "\n";
    io::write_atomically(folder.join("report.json"), |w| w.write_all(json.as_bytes()))?;
    let page = html::page(report, &shown);
    io::write_atomically(folder.join("report.html"), |w| w.write_all(page.as_bytes()))?;
    Ok(())
}

fn pictures(asset: &Asset, take: &Take, names: &Names, progress: &mut Progress) -> Result<Shown, Error> {
    let stage = Stage::new(asset, take)?;
    let frames = stage.frames();
    let mut stop = Ok(());
    let mut drawn = (0..frames).map_while(|t| {
        stop = tell(progress, Event::Step { done: t as f64 / frames as f64, loss: None });
        stop.is_ok().then(|| stage.views(t))
    });
    let written = write_mp4(&names.views, &mut drawn, take.motion.fps);
    if stop.is_err() {
        let _ = std::fs::remove_file(&names.views);
        stop?;
    }
    written?;
    write_png(&names.sheet, &stage.contact_sheet())?;
    let bytes = |path: &Path| std::fs::read(path).map_err(Error::io(path));
    Ok(Shown { views: bytes(&names.views)?, sheet: bytes(&names.sheet)? })
}

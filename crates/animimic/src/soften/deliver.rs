//! Writes the files of a softened clip.

use super::Soften;
use super::body::Softened;
use crate::Error;
use crate::event::Progress;
use crate::film::film;
use crate::physics::{Delivery, deliver};
use crate::pictures::Studio;
use animimic_render::overlay;
use animimic_scene::io::gltf::ExportOptions;
use animimic_scene::{Asset, Camera, Image, io};
use glam::DVec3;
use serde_json::{Value, json};
use std::io::Write;

const BACKGROUND: [u8; 3] = [226, 228, 230];
const INK: [u8; 3] = [40, 40, 48];
/// The view: from the front and a little above, so that depth shows [rad], and how much room is left around.
const AZIMUTH: f64 = 0.7;
const ELEVATION: f64 = 0.2;
const FIELD_OF_VIEW: f64 = 0.6;
const ROOM: f64 = 1.05;

/// Writes all files; returns the report, with what was learnt from a video.
pub fn write(
    job: &Soften,
    asset: &Asset,
    softened: &Softened,
    learnt: Value,
    progress: &mut Progress,
) -> Result<Value, Error> {
    std::fs::create_dir_all(&job.out).map_err(Error::io(&job.out))?;
    let glb = job.out.join("softened.glb");
    let mut report = report(job, asset, softened);
    learnt.as_object().into_iter().flatten().for_each(|(k, v)| report[k] = v.clone());
    let options = ExportOptions { youngs: softened.youngs.clone(), extras: report.clone(), ..Default::default() };
    let clips = [softened.refined()];
    let delivered = deliver(job.physics, &Delivery { asset, clips: &clips, glb: &glb, options })?;
    views(job, asset, softened, progress)?;
    let mut report = report;
    report["export"] = delivered.to_json();
    report["simulated_s"] = softened.simulated_s.into();
    let text = serde_json::to_string_pretty(&report).expect("a report has string keys and finite numbers") + "\n";
    io::write_atomically(job.out.join("report.json"), |w| w.write_all(text.as_bytes()))?;
    Ok(report)
}

fn report(job: &Soften, asset: &Asset, softened: &Softened) -> Value {
    let names: Vec<String> =
        job.softness.iter().map(|s| format!("{}={:e}", s.material.as_deref().unwrap_or("all"), s.young)).collect();
    let mut report = json!({
        "program": concat!("animimic ", env!("CARGO_PKG_VERSION")),
        "clip": softened.motion.name, "frames": softened.motion.poses.len(), "fps": softened.motion.fps,
        "young": names, "size_m": job.size_m, "loose": job.loose, "damping": job.damping,
    });
    let own = softened.to_json(asset.mesh.diagonal());
    own.as_object().into_iter().flatten().for_each(|(k, v)| report[k] = v.clone());
    report
}

/// Skinning and soft tissue side by side.
fn views(job: &Soften, asset: &Asset, softened: &Softened, progress: &mut Progress) -> Result<(), Error> {
    let studio = Studio::with_light(asset, Default::default())?;
    let side = job.height_px;
    let camera = camera(&softened.skinned, side as u32);
    let frames = softened.soft.len();
    let draw = |t: usize| {
        let mut out = Image::filled(2 * side, side, BACKGROUND);
        for (k, (surface, label)) in [(&softened.skinned, "skinning"), (&softened.soft, "soft")].into_iter().enumerate()
        {
            overlay::paste(&mut out, &studio.draw(&camera, &surface[t], BACKGROUND).0, k * side, 0);
            overlay::text(&mut out, k * side + 8, 8, label, 1, INK);
        }
        out
    };
    film(&job.out.join("views.mp4"), (frames, softened.motion.fps), (0.0, 1.0), draw, progress)
}

/// A square view that sees the whole clip.
fn camera(frames: &[Vec<DVec3>], side: u32) -> Camera {
    let all: Vec<DVec3> = frames.iter().map(|f| animimic_scene::mesh::bounds(f)).flat_map(|(a, b)| [a, b]).collect();
    let (low, high) = animimic_scene::mesh::bounds(&all);
    let distance = ROOM * 0.5 * low.distance(high) / (0.5 * FIELD_OF_VIEW).sin();
    Camera::orbit(0.5 * (low + high), distance, AZIMUTH, ELEVATION, FIELD_OF_VIEW, side, side)
}

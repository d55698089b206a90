//! Soft tissue on the true joint motion of every case: what the simulation keeps, what it costs, and pictures of it.
//! `cargo run --release -p animimic --example soft_cases -- FOLDER YOUNG [CASE…]` draws six frames of each case into the folder,
//! skinning above and soft tissue of that Young's modulus [Pa] below.

mod recorded;

use animimic::pictures::Studio;
use animimic::scene::{Asset, Image, io};
use animimic::sim::{Elasticity, Model};
use animimic::soften::yielding::give_way;
use animimic_fit::soft::learn::skinned;
use animimic_fit::soft::{Settings, Stepping, Tissue};
use glam::DVec3;
use std::path::Path;
use std::time::Instant;

const BACKGROUND: [u8; 3] = [226, 228, 230];
/// Frames in a sheet, and the side of each [px].
const COLUMNS: usize = 6;
const CELL: usize = 400;

fn main() {
    let Some(folder) = recorded::cases() else { return println!("the test data is absent") };
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, youngs, wanted @ ..] = arguments.as_slice() else { return println!("soft_cases FOLDER YOUNG [CASE…]") };
    let youngs: f64 = youngs.parse().expect("Young's modulus is a number");
    for name in recorded::names(&folder).iter().filter(|n| wanted.is_empty() || wanted.contains(n)) {
        let (asset, motion) = recorded::recorded(&folder.join(name));
        let clock = Instant::now();
        let tissue = Tissue::new(&asset, &Settings::default()).expect("a model with a surface");
        let built = clock.elapsed().as_secs_f64();
        let elasticity = Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), youngs, 0.4, 1000.0);
        let clock = Instant::now();
        let simulated =
            tissue.simulate(&elasticity, &Stepping::default(), &motion.poses, motion.fps).expect("good input");
        let spent = clock.elapsed().as_secs_f64();
        let skinned = skinned(&asset, &motion.poses);
        let mut soft = simulated.surfaces(&tissue, &motion.poses);
        let yielded = give_way(&asset.mesh, &skinned, &mut soft);
        let r = &simulated.report;
        println!(
            "{name}: {} tets, built in {built:.2} s; {} frames in {spent:.2} s, {} steps each, inverted {}, missed {}, volume {:.3}; crossings {} of skinning, {} -> {} soft, {:.2} yielded",
            tissue.body.tets.len(),
            motion.poses.len(),
            r.substeps,
            r.inverted,
            r.unconverged.len(),
            r.volume_change,
            yielded.skinned_pairs,
            yielded.soft_pairs,
            yielded.pairs,
            yielded.share
        );
        let picture = sheet(&asset, &folder.join(name), [&skinned, &soft]);
        animimic_video::write_png(&Path::new(out).join(format!("{name}.png")), &picture).expect("a writable folder");
    }
}

/// Frames of both surfaces, one row each.
fn sheet(asset: &Asset, case: &Path, rows: [&[Vec<DVec3>]; 2]) -> Image {
    let camera = io::camera_json::read(case.join("camera.json")).expect("a camera").main;
    let camera = camera.resized(CELL as u32, CELL as u32);
    let studio = Studio::with_light(asset, Default::default()).expect("a model that can be drawn");
    let mut sheet = Image::filled(CELL * COLUMNS, 2 * CELL, BACKGROUND);
    for (row, frames) in rows.iter().enumerate() {
        for k in 0..COLUMNS {
            let picture = studio.draw(&camera, &frames[k * (frames.len() - 1) / (COLUMNS - 1)], BACKGROUND).0;
            animimic_render::overlay::paste(&mut sheet, &picture, CELL * k, CELL * row);
        }
    }
    sheet
}

//! Bend test of made rigs: `bends DIR [MODEL…]`, without models for all of the test data.
//!
//! For each model a sheet `DIR/NAME.png`: skeleton and weights at rest, then the model once for each main joint, which alone is turned by
//! 40° about the line of sight: what bends badly shows.
// An example ends at the first thing that is wrong.
#![allow(clippy::unwrap_used)]

use animimic::pictures::Studio;
use animimic::rigging::Sheet;
use animimic::scene::{Asset, Camera, Image, Pose, io};
use animimic_render::{Light, overlay};
use animimic_rig::riggers::{self, RigOptions};
use glam::{DQuat, DVec3};
use std::path::{Path, PathBuf};
use std::time::Instant;

const BEND_DEG: f64 = 40.0;
const CELL_PX: usize = 256;
const COLUMNS: usize = 8;
/// Most joints on a sheet, those that move most of the surface.
const MOST: usize = 30;
const AZIMUTH_RAD: f64 = 0.8;
const ELEVATION_RAD: f64 = 0.25;
const VIEW_ANGLE_RAD: f64 = 0.2;
/// Distance of the camera [diagonal].
const DISTANCE: f64 = 6.0;
const WHITE: [u8; 3] = [244, 245, 246];

fn main() {
    let mut words = std::env::args().skip(1);
    let folder = PathBuf::from(words.next().expect("bends DIR [MODEL…]"));
    let given: Vec<PathBuf> = words.map(PathBuf::from).collect();
    std::fs::create_dir_all(&folder).unwrap();
    for path in if given.is_empty() { all() } else { given } {
        let mut asset = match io::read(&path) {
            Ok(asset) => asset,
            Err(e) => {
                println!("{:24} refused: {e}", label(&path));
                continue;
            }
        };
        let start = Instant::now();
        let rig = riggers::RIGGERS[0].rig(&asset, &RigOptions::default()).unwrap();
        let secs = start.elapsed().as_secs_f64();
        riggers::attach(&mut asset, rig);
        let joints = main_joints(&asset);
        let (all, faces) = (asset.rig.skeleton.joints.len(), asset.mesh.triangles.len());
        println!("{:24} {faces:8} faces {all:3} joints {:3} of them bent {secs:7.2} s", label(&path), joints.len());
        let file = folder.join(label(&path)).with_extension("png");
        animimic_video::write_png(&file, &sheet(&asset, &joints, &label(&path))).unwrap();
    }
}

/// The models of the test data: those whose artists' rigs are taken away, the still ones and the real ones.
fn all() -> Vec<PathBuf> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let list = |folder: &str| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(data.join(folder)).into_iter().flatten().flatten();
        let mut found: Vec<PathBuf> = entries.map(|e| e.path()).collect();
        found.sort();
        found
    };
    let models = ["obj", "off", "stl", "gltf", "glb", "ply"];
    let is_model = |p: &PathBuf| p.extension().is_some_and(|e| models.contains(&&*e.to_string_lossy().to_lowercase()));
    let known = list("gt").into_iter().map(|p| p.join("static_norig.glb"));
    let real = list("real").into_iter().map(|p| p.join("objs/mesh.obj"));
    let still = list("static").into_iter().filter(is_model);
    known.chain(still).chain(real).filter(|p| p.is_file()).collect()
}

/// The model's name: that of its folder where the file's says nothing.
fn label(path: &Path) -> String {
    let name = |p: Option<&Path>| p.and_then(Path::file_stem).unwrap_or_default().to_string_lossy().into_owned();
    match name(Some(path)).as_str() {
        "static_norig" => name(path.parent()),
        "mesh" => name(path.parent().and_then(Path::parent)),
        own => own.to_owned(),
    }
}

/// Joints that turn more of the surface than others, in the order of the skeleton; neither the root nor ends.
fn main_joints(asset: &Asset) -> Vec<usize> {
    let rig = &asset.rig;
    let joints = &rig.skeleton.joints;
    let mut moved = vec![0.0; joints.len()];
    for influence in rig.skin.influences.iter().flatten() {
        moved[rig.skin.slots[influence.slot as usize].joint] += influence.weight;
    }
    for j in (0..joints.len()).rev() {
        if let Some(parent) = joints[j].parent {
            moved[parent] += moved[j];
        }
    }
    let mut main: Vec<usize> = (0..joints.len()).filter(|&j| joints[j].parent.is_some() && moved[j] > 0.0).collect();
    main.sort_by(|&a, &b| moved[b].total_cmp(&moved[a]));
    main.truncate(MOST);
    main.sort_unstable();
    main
}

fn sheet(asset: &Asset, joints: &[usize], name: &str) -> Image {
    let (low, high) = asset.mesh.bounds();
    let (center, distance) = (0.5 * (low + high), DISTANCE * low.distance(high));
    let side = CELL_PX as u32;
    let camera = Camera::orbit(center, distance, AZIMUTH_RAD, ELEVATION_RAD, VIEW_ANGLE_RAD, side, side);
    let studio = Studio::with_light(asset, Light::default()).unwrap();
    let skeleton = &asset.rig.skeleton;
    let rest = skeleton.rest_world();
    let places: Vec<DVec3> = rest.iter().map(|w| w.translation).collect();
    let pair = Sheet::new(asset).unwrap().view(AZIMUTH_RAD, ELEVATION_RAD, &asset.mesh.positions, &places);
    let rows = (joints.len() + 2).div_ceil(COLUMNS);
    let mut out = Image::filled(COLUMNS * CELL_PX, rows * CELL_PX, WHITE);
    overlay::paste(&mut out, &pair.resized(2 * CELL_PX, CELL_PX), 0, 0);
    overlay::text(&mut out, 4, 4, name, 1, [0; 3]);
    for (k, &j) in joints.iter().enumerate() {
        let mut locals = skeleton.rest_locals();
        let line_of_sight = (camera.eye() - places[j]).normalize();
        let turn = DQuat::from_axis_angle(line_of_sight, BEND_DEG.to_radians());
        // World turn W about the joint: local rotation P⁻¹ W P R with the parent's world rotation P.
        let parent = skeleton.joints[j].parent.map_or(DQuat::IDENTITY, |p| DQuat::from_mat3(&rest[p].matrix3));
        locals[j].rotation = parent.inverse() * turn * parent * locals[j].rotation;
        let bent = asset.rig.in_pose(&Pose { locals });
        let (x, y) = ((k + 2) % COLUMNS * CELL_PX, (k + 2) / COLUMNS * CELL_PX);
        overlay::paste(&mut out, &studio.draw(&camera, &bent, WHITE).0, x, y);
        overlay::text(&mut out, x + 4, y + 4, &skeleton.joints[j].name, 1, [0; 3]);
    }
    out
}

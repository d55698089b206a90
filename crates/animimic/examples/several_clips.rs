//! Writes models with three clips in one GLB, for the outside judges in `tests/interop`: each clip moves other joints for another time.
//!
//! `several_clips OUT_DIR MODEL…` makes `OUT_DIR/NAME_clips.glb` (the skeleton alone) and `NAME_clips_helpers.glb` (the flesh swings
//! too, in waves of each clip's own, on helper bones that all three share) with an npz each: `clip_K_times` [s], `clip_K_vertices`
//! (our own forward kinematics of the file), `rest`, `diagonal`.

use animimic::physics::{Delivery, deliver};
use animimic::scene::io::gltf::{ExportOptions, clips};
use animimic::scene::io::npz::{Archive, Array, Values};
use animimic::scene::io::{self, npz};
use animimic::scene::{Asset, Motion, Pose, Refined, Trajectory, Transform};
use glam::{DQuat, DVec3};
use std::path::Path;

const FPS: f64 = 24.0;
const SAMPLES: usize = 5;
/// Names and lengths of the clips [frames].
const CLIPS: [(&str, usize); 3] = [("walk", 25), ("jump", 13), ("look around", 37)];

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("usage: several_clips OUT_DIR MODEL…")?;
    for model in arguments {
        match write(Path::new(&model), Path::new(&folder)) {
            Ok(names) => names.iter().for_each(|name| println!("{name}\t{model}")),
            Err(e) => println!("left out: {model}: {e}"),
        }
    }
    Ok(())
}

fn write(model: &Path, folder: &Path) -> Result<Vec<String>> {
    let asset = io::read(model)?;
    if !asset.rig.is_articulated() {
        return Err("has no skeleton".into());
    }
    let words: Vec<String> =
        model.components().rev().take(2).map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
    let mut names = Vec::new();
    for (end, soft) in [("clips", false), ("clips_helpers", true)] {
        let name = format!("{}_{}_{end}", words[1], words[0].replace('.', "_"));
        let glb = folder.join(format!("{name}.glb"));
        let clips: Vec<Refined> = (0..CLIPS.len()).map(|k| clip(&asset, k, soft)).collect();
        let options = ExportOptions { keep_clips: false, ..ExportOptions::default() };
        let told = deliver("rig".parse()?, &Delivery { asset: &asset, clips: &clips, glb: &glb, options })?;
        eprintln!("{name}: {}", told.words());
        npz::write(glb.with_extension("npz"), &expected(&io::read(&glb)?)?)?;
        names.push(name);
    }
    Ok(names)
}

/// Clip number `k`: every third joint swings in it, from the k-th; the root travels in the last.
fn clip(asset: &Asset, k: usize, soft: bool) -> Refined {
    let joints = &asset.rig.skeleton.joints;
    let (name, frames) = CLIPS[k];
    let (low, high) = asset.mesh.bounds();
    let (middle, size) = (0.5 * (low + high), asset.mesh.diagonal());
    let pose = |f: usize| {
        let phase = f as f64 / FPS * std::f64::consts::TAU;
        let local = |j: usize| {
            let turn = if j % CLIPS.len() == k { 0.3 * (phase + j as f64).sin() } else { 0.0 };
            let travel = if j == 0 && k == 2 { DVec3::X * 0.1 * size * phase.sin() } else { DVec3::ZERO };
            let axis = DVec3::new((k == 1) as u8 as f64, 1.0, (j % 2) as f64).normalize();
            Transform {
                translation: joints[j].rest.translation + travel,
                rotation: joints[j].rest.rotation * DQuat::from_axis_angle(axis, turn),
                ..joints[j].rest
            }
        };
        Pose { locals: (0..joints.len()).map(local).collect() }
    };
    let motion = Motion { name: name.into(), fps: FPS, poses: (0..frames).map(pose).collect() };
    let wave = |f: usize, surface: Vec<DVec3>| -> Vec<DVec3> {
        let t = f as f64 / (3.0 + k as f64);
        let pushed = |(p, x): (DVec3, &DVec3)| {
            let away = (*x - middle) / size;
            let strength = 0.2 * size * away.length_squared() * t.min(1.0);
            p + DVec3::new((t + 3.0 * away.y).sin(), (1.3 * t + k as f64).sin(), (1.7 * t + 3.0 * away.x).sin())
                * strength
        };
        surface.into_iter().zip(&asset.mesh.positions).map(pushed).collect()
    };
    let frames = || posed(asset, &motion).into_iter().enumerate().map(|(f, surface)| wave(f, surface)).collect();
    let trajectory = soft.then(|| Trajectory { fps: FPS, frames: frames() });
    Refined { motion, trajectory }
}

fn posed(asset: &Asset, motion: &Motion) -> Vec<Vec<DVec3>> {
    motion.poses.iter().map(|p| asset.rig.skinned(&asset.rig.skeleton.world_from_joint(&p.locals))).collect()
}

/// What our own forward kinematics makes of a file's clips.
fn expected(file: &Asset) -> Result<Archive> {
    let n = file.mesh.positions.len();
    let flat = |points: &[DVec3]| -> Vec<f64> { points.iter().flat_map(|p| p.to_array()).collect() };
    let array =
        |name: String, shape: Vec<usize>, values: Vec<f64>| (name, Array { shape, values: Values::F64(values) });
    let mut arrays = vec![
        array("diagonal".into(), vec![], vec![file.mesh.diagonal()]),
        array("rest".into(), vec![n, 3], flat(&file.mesh.positions)),
    ];
    for (k, clip) in clips(file)?.iter().enumerate() {
        let frames = posed(file, &clip.motion(&file.rig.skeleton, FPS)?);
        let picked: Vec<usize> = (0..SAMPLES).map(|s| s * (frames.len() - 1) / (SAMPLES - 1)).collect();
        arrays.push(array(format!("clip_{k}_times"), vec![SAMPLES], picked.iter().map(|&f| f as f64 / FPS).collect()));
        let vertices = picked.iter().flat_map(|&f| flat(&frames[f])).collect();
        arrays.push(array(format!("clip_{k}_vertices"), vec![SAMPLES, n, 3], vertices));
    }
    Ok(Archive { arrays })
}

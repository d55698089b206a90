//! Writes models with three clips in one GLB, for the outside judges in `tests/interop`: each clip moves other joints for another time.
//!
//! `several_clips OUT_DIR MODEL…` makes `OUT_DIR/NAME_clips.glb` (the skeleton alone) and `NAME_clips_helpers.glb` (the flesh swings
//! too, in waves of each clip's own, on helper bones that all three share) with an npz each: `clip_K_times` [s], `clip_K_vertices`
//! (our own forward kinematics of the file), `rest`, `diagonal`.

mod judged;

use animimic::physics::{Delivery, deliver};
use animimic::scene::io::gltf::{ExportOptions, clips};
use animimic::scene::io::npz::Archive;
use animimic::scene::io::{self, npz};
use animimic::scene::{Asset, Motion, Pose, Refined, Trajectory, Transform};
use glam::{DQuat, DVec3};
use judged::{FPS, Result, array, each_model, flat, posed, sampled};
use std::path::Path;

/// Names and lengths of the clips [frames].
const CLIPS: [(&str, usize); 3] = [("walk", 25), ("jump", 13), ("look around", 37)];

fn main() -> Result<()> {
    each_model("several_clips", |asset, _, name, folder| write(asset, name, folder))
}

fn write(asset: &Asset, beginning: &str, folder: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for (end, soft) in [("clips", false), ("clips_helpers", true)] {
        let name = format!("{beginning}_{end}");
        let glb = folder.join(format!("{name}.glb"));
        let clips: Vec<Refined> = (0..CLIPS.len()).map(|k| clip(asset, k, soft)).collect();
        let options = ExportOptions { keep_clips: false, ..ExportOptions::default() };
        let told = deliver("rig".parse()?, &Delivery { asset, clips: &clips, glb: &glb, options })?;
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

/// What our own forward kinematics makes of a file's clips.
fn expected(file: &Asset) -> Result<Archive> {
    let rest = &file.mesh.positions;
    let mut arrays =
        vec![array("diagonal", &[], vec![file.mesh.diagonal()]), array("rest", &[rest.len(), 3], flat(rest))];
    for (k, clip) in clips(file)?.iter().enumerate() {
        arrays.extend(sampled(k, &posed(file, &clip.motion(&file.rig.skeleton, FPS)?)));
    }
    Ok(Archive { arrays })
}

//! Writes models with motion that goes beyond their skeleton, as helper bones and as morph targets, for the outside judges in `tests/interop`.
//!
//! `refined OUT_DIR MODEL…` makes `OUT_DIR/NAME_none.glb` (the base clip), `NAME_rig.glb` and `NAME_morph.glb` with an npz each: `clip_0_times` [s], `clip_0_vertices`
//! (what the file should play at those times), `tolerance` [share of the diagonal], `rest`, `diagonal`. With helpers that is our own forward
//! kinematics of the file; with morph targets it is the wanted surface, and the tolerance is the residual that was told.
//! A model beside a `soft.npz` moves as the truth in its folder; others swing every joint, and their flesh swings in waves of its own.

mod judged;

use animimic::physics::{Delivered, Delivery, deliver};
use animimic::scene::io::gltf::{ExportOptions, clips};
use animimic::scene::io::npz::Archive;
use animimic::scene::io::{self, npz};
use animimic::scene::{Asset, Motion, Pose, Refined, Trajectory, Transform};
use glam::{DQuat, DVec3};
use judged::{FPS, Result, array, each_model, flat, posed, sampled};
use std::path::Path;

/// What two programs may differ by in adding up the same numbers [share of the diagonal].
const ROUNDING: f64 = 1e-4;

fn main() -> Result<()> {
    each_model("refined", refine)
}

fn refine(asset: &Asset, model: &Path, beginning: &str, folder: &Path) -> Result<Vec<String>> {
    let beside = model.parent().unwrap_or(Path::new("."));
    let clip = if beside.join("soft.npz").is_file() { truth(asset, beside)? } else { shaken(asset)? };
    let mut names = Vec::new();
    for physics in ["none", "rig", "morph"] {
        let name = format!("{beginning}_{physics}");
        let glb = folder.join(format!("{name}.glb"));
        let options = ExportOptions { keep_clips: false, ..ExportOptions::default() };
        let clips = std::slice::from_ref(&clip);
        let told = deliver(physics.parse()?, &Delivery { asset, clips, glb: &glb, options })?;
        eprintln!("{name}: {}", told.words());
        npz::write(glb.with_extension("npz"), &expected(asset, &clip, &glb, &told)?)?;
        names.push(name);
    }
    Ok(names)
}

fn expected(asset: &Asset, clip: &Refined, glb: &Path, told: &Delivered) -> Result<Archive> {
    let wanted = clip.trajectory.as_ref().ok_or("has no trajectory")?;
    let (vertices, tolerance) = if told.encoding != "morph" {
        let file = io::read(glb)?;
        let motion = clips(&file)?[0].motion(&file.rig.skeleton, FPS)?;
        (posed(&file, &motion), ROUNDING)
    } else {
        (wanted.frames.clone(), told.residual.largest + ROUNDING)
    };
    let rest = &asset.mesh.positions;
    let mut arrays = vec![
        array("diagonal", &[], vec![asset.mesh.diagonal()]),
        array("tolerance", &[], vec![tolerance]),
        array("rest", &[rest.len(), 3], flat(rest)),
    ];
    arrays.extend(sampled(0, &vertices));
    Ok(Archive { arrays })
}

/// The true joints and vertices of a folder.
fn truth(asset: &Asset, folder: &Path) -> Result<Refined> {
    let gt = npz::read(folder.join("gt.npz"))?;
    let (unique, map) = (gt.need("verts_unique")?, gt.need("vert_to_unique")?.to_f64());
    let points: Vec<DVec3> = unique.to_f64().chunks_exact(3).map(DVec3::from_slice).collect();
    let frames = points.chunks_exact(unique.shape[1]).map(|f| map.iter().map(|&i| f[i as usize]).collect()).collect();
    let nodes = gt.need("joint_node")?.to_f64();
    let pose = |trs: &[f64]| {
        let mut locals = asset.rig.skeleton.rest_locals();
        for (node, t) in nodes.iter().zip(trs.chunks_exact(10)) {
            if let Some(j) = asset.rig.skeleton.joints.iter().position(|j| j.node == Some(*node as usize)) {
                locals[j] = Transform {
                    translation: DVec3::from_slice(&t[..3]),
                    rotation: DQuat::from_slice(&t[3..7]).normalize(),
                    scale: DVec3::from_slice(&t[7..]),
                };
            }
        }
        Pose { locals }
    };
    let poses = gt.need("joint_local_trs")?.to_f64().chunks_exact(nodes.len() * 10).map(pose).collect();
    let motion = Motion { name: "truth".into(), fps: FPS, poses };
    Ok(Refined { motion, trajectory: Some(Trajectory { fps: FPS, frames }) })
}

/// The model's first clip, or a swing of every joint, with waves on top that are stronger away from the middle.
fn shaken(asset: &Asset) -> Result<Refined> {
    let joints = &asset.rig.skeleton.joints;
    let swing = |f: usize| {
        let phase = f as f64 / FPS * std::f64::consts::TAU;
        let turn = |j: usize| DQuat::from_rotation_z(0.2 * ((phase + j as f64).sin() - (j as f64).sin()));
        let local = |j: usize| Transform { rotation: joints[j].rest.rotation * turn(j), ..joints[j].rest };
        Pose { locals: (0..joints.len()).map(local).collect() }
    };
    let motion = match clips(asset)?.first() {
        Some(clip) => clip.motion(&asset.rig.skeleton, FPS)?,
        None => Motion { name: "swing".into(), fps: FPS, poses: (0..25).map(swing).collect() },
    };
    let (low, high) = asset.mesh.bounds();
    let (middle, size) = (0.5 * (low + high), asset.mesh.diagonal());
    let mut frames = posed(asset, &motion);
    for (f, frame) in frames.iter_mut().enumerate() {
        let t = f as f64 / 4.0;
        for (p, x) in frame.iter_mut().zip(&asset.mesh.positions) {
            let away = (*x - middle) / size;
            let strength = 0.2 * size * away.length_squared() * t.min(1.0);
            *p += DVec3::new((t + 3.0 * away.y).sin(), (1.3 * t).sin(), (1.7 * t + 3.0 * away.x).sin()) * strength;
        }
    }
    Ok(Refined { motion, trajectory: Some(Trajectory { fps: FPS, frames }) })
}

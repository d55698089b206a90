//! Writes models again with clips, and our own forward kinematics of them, for the outside judges in `tests/interop`.
//!
//! `roundtrip OUT_DIR MODEL…` makes `OUT_DIR/NAME.glb` and `OUT_DIR/NAME.npz` (`names` in the clips' order as `clip_K_times` [s] and
//! `clip_K_vertices`, \[time\]\[vertex\]\[xyz\] in the order (node, primitive); `diagonal`; `rest`). Models with clips get those, resampled through
//! [`Motion`]; others a swing of every joint; models without skeleton are given a chain of three joints.

use animimic_scene::io::gltf::{ExportOptions, clips, write_clips};
use animimic_scene::io::npz::{Archive, Array, Values};
use animimic_scene::io::{self, write_atomically};
use animimic_scene::{Asset, Influence, Joint, Motion, Pose, Skin, Slot, Transform};
use glam::{DAffine3, DQuat, DVec3};
use std::io::Write;
use std::path::Path;

const FPS: f64 = 24.0;
const SAMPLES: usize = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("usage: roundtrip OUT_DIR MODEL…")?;
    for model in arguments {
        match roundtrip(Path::new(&model), Path::new(&folder)) {
            Ok(name) => println!("{name}\t{model}"),
            Err(e) => println!("left out: {e}"),
        }
    }
    Ok(())
}

fn roundtrip(model: &Path, folder: &Path) -> Result<String, Box<dyn std::error::Error>> {
    let mut asset = io::read(model)?;
    if asset.rig.skeleton.joints.len() == 1 {
        chain(&mut asset);
    }
    let skeleton = &asset.rig.skeleton;
    let mut motions: Vec<Motion> = Vec::new();
    for clip in clips(&asset)? {
        motions.push(clip.motion(skeleton, FPS)?);
    }
    if motions.is_empty() {
        motions.push(swing(&asset));
    }
    let options = ExportOptions {
        keep_clips: false,
        extras: serde_json::json!({ "version": env!("CARGO_PKG_VERSION") }),
        ..ExportOptions::default()
    };
    let bytes = write_clips(&asset, &motions, &options)?;
    let words: Vec<String> =
        model.components().rev().take(2).map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
    let name = format!("{}_{}", words[1], words[0].replace('.', "_"));
    write_atomically(folder.join(format!("{name}.glb")), |w| w.write_all(&bytes))?;
    io::npz::write(folder.join(format!("{name}.npz")), &kinematics(&asset, &motions))?;
    Ok(name)
}

/// Our own vertices at a few frames of every clip.
fn kinematics(asset: &Asset, motions: &[Motion]) -> Archive {
    let rest: Vec<f64> = asset.mesh.positions.iter().flat_map(|p| p.to_array()).collect();
    let mut arrays = vec![
        ("diagonal".to_string(), Array { shape: vec![], values: Values::F64(vec![asset.mesh.diagonal()]) }),
        ("rest".to_string(), Array { shape: vec![asset.mesh.positions.len(), 3], values: Values::F64(rest) }),
    ];
    for (k, motion) in motions.iter().enumerate() {
        let frames: Vec<usize> = (0..SAMPLES).map(|s| s * (motion.poses.len() - 1) / (SAMPLES - 1)).collect();
        let times = frames.iter().map(|&f| f as f64 / motion.fps).collect();
        let vertices: Vec<f64> =
            frames.iter().flat_map(|&f| asset.rig.in_pose(&motion.poses[f])).flat_map(|p| p.to_array()).collect();
        let shape = vec![SAMPLES, asset.mesh.positions.len(), 3];
        arrays.push((format!("clip_{k}_times"), Array { shape: vec![SAMPLES], values: Values::F64(times) }));
        arrays.push((format!("clip_{k}_vertices"), Array { shape, values: Values::F64(vertices) }));
    }
    Archive { arrays }
}

/// Every joint swings about an axis of its own; the first also travels.
fn swing(asset: &Asset) -> Motion {
    let joints = &asset.rig.skeleton.joints;
    let frame = |f: usize| {
        let phase = f as f64 / FPS * std::f64::consts::TAU;
        let locals = joints.iter().enumerate().map(|(j, joint)| {
            let axis = DVec3::new((j % 3) as f64, 1.0, (j % 2) as f64).normalize();
            let turn = DQuat::from_axis_angle(axis, 0.4 * (phase + j as f64).sin());
            let travel = if j == 0 { DVec3::X * 0.1 * asset.mesh.diagonal() * phase.sin() } else { DVec3::ZERO };
            Transform {
                translation: joint.rest.translation + travel,
                rotation: joint.rest.rotation * turn,
                ..joint.rest
            }
        });
        Pose { locals: locals.collect() }
    };
    Motion { name: "swing".into(), fps: FPS, poses: (0..25).map(frame).collect() }
}

/// A chain of three joints along the longest axis, with linear weights between them.
fn chain(asset: &mut Asset) {
    let (lo, hi) = asset.mesh.bounds();
    let size = hi - lo;
    let axis = if size.x >= size.y.max(size.z) {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let centre = (lo + hi) * 0.5;
    let at = |k: usize| {
        let mut p = centre;
        p[axis] = lo[axis] + size[axis] * k as f64 / 2.0;
        p
    };
    let joint = |k: usize| Joint {
        name: format!("bone.{k}"),
        parent: k.checked_sub(1),
        rest: Transform { translation: if k == 0 { at(0) } else { at(k) - at(k - 1) }, ..Transform::IDENTITY },
        node: None,
    };
    let influences = |p: &DVec3| {
        let s = 2.0 * (p[axis] - lo[axis]) / size[axis];
        let k = (s.floor() as usize).min(1);
        let u = s - k as f64;
        let pair = [(k, 1.0 - u), (k + 1, u)].map(|(k, weight)| Influence { slot: k as u32, weight });
        pair.into_iter().filter(|i| i.weight > 0.0).collect()
    };
    asset.rig.skeleton.joints = (0..3).map(joint).collect();
    asset.rig.skin = Skin {
        slots: (0..3).map(|k| Slot { joint: k, inverse_bind: DAffine3::from_translation(-at(k)) }).collect(),
        bind_positions: asset.mesh.positions.clone(),
        influences: asset.mesh.positions.iter().map(influences).collect(),
    };
}

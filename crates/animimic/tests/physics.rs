//! Every way to deliver refined motion, on models made by code, read back from the files.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use animimic::physics::{Delivered, Delivery, ENCODINGS, Physics, deliver};
use animimic_rig::Residual;
use animimic_scene::io::gltf::{ExportOptions, clips, write_clips};
use animimic_scene::io::{self, ReadOptions};
use animimic_scene::*;
use glam::{DAffine3, DQuat, DVec3};
use serde_json::{Value, json};
use std::path::Path;

const FPS: f64 = 24.0;
const RINGS: usize = 40;
const AROUND: usize = 12;

/// A worm along X on a chain of four joints, with a rigid box hung on its last joint, written to GLB and read back.
/// `posed` gives it a displayed rest that is not its bind pose.
fn worm(posed: bool) -> Asset {
    let mut asset = Asset { looks: vec![Look::default()], ..Asset::default() };
    for j in 0..4usize {
        let translation = if j == 0 { DVec3::ZERO } else { DVec3::X };
        let rest = Transform { translation, ..Transform::IDENTITY };
        asset.rig.skeleton.joints.push(Joint { name: format!("bone{j}"), parent: j.checked_sub(1), rest, node: None });
        let inverse_bind = DAffine3::from_translation(-DVec3::X * j as f64);
        asset.rig.skin.slots.push(Slot { joint: j, inverse_bind });
    }
    let mesh = &mut asset.mesh;
    for r in 0..RINGS {
        for a in 0..AROUND {
            let (x, angle) = (3.0 * r as f64 / (RINGS - 1) as f64, a as f64 / AROUND as f64 * std::f64::consts::TAU);
            mesh.positions.push(DVec3::new(x, 0.4 * angle.cos(), 0.4 * angle.sin()));
            let j = (x as usize).min(2);
            let u = x - j as f64;
            let pair = [(j, 1.0 - u), (j + 1, u)].map(|(j, weight)| Influence { slot: j as u32, weight });
            asset.rig.skin.influences.push(pair.into_iter().filter(|i| i.weight > 0.0).collect());
        }
    }
    for r in 0..RINGS - 1 {
        for a in 0..AROUND {
            let at = |r: usize, a: usize| (r * AROUND + a % AROUND) as u32;
            mesh.triangles.push([at(r, a), at(r + 1, a), at(r, a + 1)]);
            mesh.triangles.push([at(r, a + 1), at(r + 1, a), at(r + 1, a + 1)]);
        }
    }
    let n = mesh.positions.len();
    mesh.welded = (0..n as u32).collect();
    mesh.welded_count = n;
    let triangles = 0..mesh.triangles.len();
    mesh.parts = vec![Part { name: "worm".into(), vertices: 0..n, triangles, look: 0, skin: None }];
    asset.rig.skin.bind_positions = asset.mesh.positions.clone();
    let bytes = write_clips(&asset, &[], &ExportOptions::default()).unwrap();
    let mut read = self::read(bytes);
    let Source::Gltf { json, buffers } = &mut read.source else { panic!("a GLB") };
    let node = |name: &str| json["nodes"].as_array().unwrap().iter().position(|n| n["name"] == name).unwrap();
    // A rigid part under the last bone that shares the worm's shape, small.
    let (last, worm) =
        (node("bone3"), json["nodes"].as_array().unwrap().iter().position(|n| n.get("mesh").is_some()).unwrap());
    let mut part = json["meshes"][json["nodes"][worm]["mesh"].as_u64().unwrap() as usize].clone();
    for key in ["JOINTS_0", "WEIGHTS_0"] {
        part["primitives"][0]["attributes"].as_object_mut().unwrap().shift_remove(key);
    }
    json["meshes"].as_array_mut().unwrap().push(part);
    let mesh = json["meshes"].as_array().unwrap().len() - 1;
    json["nodes"]
        .as_array_mut()
        .unwrap()
        .push(json!({ "name": "hat", "mesh": mesh, "translation": [0.2, 0.5, 0.0], "scale": [0.2, 0.2, 0.2] }));
    let hat = json["nodes"].as_array().unwrap().len() - 1;
    json["nodes"][last]["children"] = json!([hat]);
    if posed {
        for name in ["bone1", "bone2"] {
            let k = node_of(json, name);
            json["nodes"][k]["rotation"] = json!(DQuat::from_rotation_z(0.5).to_array());
        }
    }
    json["asset"]["extras"] = json!({ "kept": [1, 2] });
    let (json, buffers) = (json.clone(), buffers.clone());
    self::read(glb(&json, &buffers[0]))
}

fn node_of(json: &Value, name: &str) -> usize {
    json["nodes"].as_array().unwrap().iter().position(|n| n["name"] == name).unwrap()
}

fn glb(json: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let total = (12 + 8 + text.len() + 8 + bin.len()) as u32;
    let mut out = b"glTF".to_vec();
    out.extend([2, total, text.len() as u32].iter().flat_map(|n: &u32| n.to_le_bytes()));
    out.extend_from_slice(b"JSON");
    out.extend(text);
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend_from_slice(b"BIN\0");
    out.extend(bin);
    out
}

fn read(bytes: Vec<u8>) -> Asset {
    io::read_bytes(bytes, Path::new("memory.glb"), &ReadOptions::default()).unwrap()
}

fn posed(asset: &Asset, motion: &Motion) -> Vec<Vec<DVec3>> {
    motion.poses.iter().map(|p| asset.rig.in_pose(p)).collect()
}

/// The worm bends; its tail half and its hat swing beyond that, more in the second clip.
fn soft(asset: &Asset, name: &str, strength: f64) -> Refined {
    let pose = |f: usize| {
        let t = f as f64 / 6.0;
        let mut locals = asset.rig.skeleton.rest_locals();
        for (j, joint) in asset.rig.skeleton.joints.iter().enumerate() {
            if joint.name.starts_with("bone") {
                locals[j].rotation *= DQuat::from_rotation_z(0.3 * (t + j as f64).sin() - 0.3 * (j as f64).sin());
            }
        }
        Pose { locals }
    };
    let motion = Motion { name: name.into(), fps: FPS, poses: (0..18).map(pose).collect() };
    let mut frames = posed(asset, &motion);
    for (f, frame) in frames.iter_mut().enumerate() {
        let t = f as f64 / 3.0;
        for (p, x) in frame.iter_mut().zip(&asset.mesh.positions) {
            let loose = (x.x - 1.5).max(0.0);
            *p += DVec3::new(0.0, (1.3 * t).sin(), (2.0 * t).sin()) * (0.15 * strength * loose * loose);
        }
    }
    Refined { motion, trajectory: Some(Trajectory { fps: FPS, frames }) }
}

fn delivered(asset: &Asset, clips: &[Refined], physics: &str, folder: &Path) -> Delivered {
    let options = ExportOptions { extras: json!({ "made": "here" }), ..ExportOptions::default() };
    let glb = folder.join(format!("{physics}.glb"));
    deliver(physics.parse::<Physics>().unwrap(), &Delivery { asset, clips, glb: &glb, options }).unwrap()
}

/// Distance of a file's clips, played by our own reader, from the trajectories.
fn played(file: &Path, wanted: &[Refined], diagonal: f64) -> Residual {
    let asset = io::read(file).unwrap();
    let found: Vec<Motion> =
        clips(&asset).unwrap().iter().map(|c| c.motion(&asset.rig.skeleton, FPS).unwrap()).collect();
    let pairs = wanted.iter().map(|w| {
        let motion = found.iter().find(|m| m.name == w.motion.name).unwrap();
        (motion, w.trajectory.as_ref().unwrap())
    });
    Residual::of_clips(&asset.rig, diagonal, pairs)
}

fn document(file: &Path) -> (Value, Vec<u8>) {
    let bytes = std::fs::read(file).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[20..20 + length]).unwrap(), bytes[28 + length..].to_vec())
}

/// Bytes of all samplers of a clip that move one of these nodes, in order.
fn keys(json: &Value, bin: &[u8], clip: usize, nodes: &[usize]) -> Vec<(u64, String, Vec<u8>)> {
    let bytes = |accessor: &Value| {
        let a = &json["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &json["bufferViews"][a["bufferView"].as_u64().unwrap() as usize];
        let start = view["byteOffset"].as_u64().unwrap_or(0) as usize;
        bin[start..start + view["byteLength"].as_u64().unwrap() as usize].to_vec()
    };
    let animation = &json["animations"][clip];
    let channels = animation["channels"].as_array().unwrap();
    let of_nodes = channels.iter().filter(|c| nodes.contains(&(c["target"]["node"].as_u64().unwrap() as usize)));
    of_nodes
        .map(|c| {
            let sampler = &animation["samplers"][c["sampler"].as_u64().unwrap() as usize];
            let mut all = bytes(&sampler["input"]);
            all.extend(bytes(&sampler["output"]));
            (c["target"]["node"].as_u64().unwrap(), c["target"]["path"].as_str().unwrap().to_owned(), all)
        })
        .collect()
}

#[test]
fn helper_bones_carry_two_clips_and_a_rigid_part_and_leave_the_given_keys_byte_for_byte() {
    for rest_is_posed in [false, true] {
        let asset = worm(rest_is_posed);
        let wanted = [soft(&asset, "slow", 0.6), soft(&asset, "fast", 1.0)];
        let folder = tempfile::tempdir().unwrap();
        let base = delivered(&asset, &wanted, "none", folder.path());
        let rig = delivered(&asset, &wanted, "rig", folder.path());
        println!("{}\n{}", base.words(), rig.words());
        assert!(base.residual.p99 > 0.02 && rig.residual.p99 <= 0.005);
        let found = played(&rig.files[0], &wanted, asset.mesh.diagonal());
        println!("read back: {found:?}");
        assert!((found.p99 - rig.residual.p99).abs() < 1e-5);
        let (a, b) = (document(&base.files[0]), document(&rig.files[0]));
        let given: Vec<usize> = asset.rig.skeleton.joints.iter().filter_map(|j| j.node).collect();
        for clip in 0..2 {
            let expected = keys(&a.0, &a.1, clip, &given);
            assert!(!expected.is_empty() && expected == keys(&b.0, &b.1, clip, &given), "clip {clip}");
        }
        assert_eq!(b.0["asset"]["extras"]["kept"], json!([1, 2]));
        let back = io::read(&rig.files[0]).unwrap();
        let worst =
            back.mesh.positions.iter().zip(&asset.mesh.positions).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        println!("rest moved by {:.1e} of the diagonal", worst / asset.mesh.diagonal());
        assert!(worst < 1e-5 * asset.mesh.diagonal());
        let rigid = node_of(&b.0, "hat");
        assert!(b.0["nodes"][rigid].get("skin").is_some(), "the rigid part became skinned");
        for primitive in b.0["meshes"].as_array().unwrap().iter().flat_map(|m| m["primitives"].as_array().unwrap()) {
            assert!(primitive["attributes"].get("JOINTS_1").is_none());
        }
    }
}

#[test]
fn joints_that_are_shown_elsewhere_than_bound_have_keys_though_they_stand_still() {
    for rest_is_posed in [false, true] {
        let asset = worm(rest_is_posed);
        let still = Pose { locals: asset.rig.skeleton.rest_locals() };
        let still = Motion { name: "still".into(), fps: FPS, poses: vec![still; 3] };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("still.glb");
        std::fs::write(&path, write_clips(&asset, &[still], &ExportOptions::default()).unwrap()).unwrap();
        let json = document(&path).0;
        let channels = json["animations"][0]["channels"].as_array().unwrap();
        let turned = |name: &str| {
            let node = node_of(&json, name);
            channels.iter().any(|c| c["target"]["node"] == node && c["target"]["path"] == "rotation")
        };
        println!("posed {rest_is_posed}: {} channels", channels.len());
        // Bones 1 and 2 are turned by half a radian where the rest is a pose; importers with a bind pose would turn them back.
        assert_eq!([turned("bone1"), turned("bone2")], [rest_is_posed; 2]);
        assert!(!turned("bone3") && channels.len() <= 2);
    }
}

#[test]
fn clips_that_the_file_has_and_keeps_play_as_before_beside_softened_ones() {
    let still = worm(false);
    let old = Refined { trajectory: None, ..soft(&still, "old", 0.0) };
    let bytes = write_clips(&still, std::slice::from_ref(&old.motion), &ExportOptions::default()).unwrap();
    let asset = read(bytes);
    let before = clips(&asset).unwrap()[0].motion(&asset.rig.skeleton, FPS).unwrap();
    let before = Refined { trajectory: Some(Trajectory { fps: FPS, frames: posed(&asset, &before) }), motion: before };
    let folder = tempfile::tempdir().unwrap();
    let rig = delivered(&asset, &[soft(&asset, "new", 1.0)], "rig", folder.path());
    let found = played(&rig.files[0], &[before], asset.mesh.diagonal());
    println!("{}; the old clip: {found:?}", rig.words());
    assert!(found.p99 <= 0.005);
}

#[test]
fn every_encoding_writes_all_its_files_and_says_what_it_loses() {
    let asset = worm(false);
    let wanted = [soft(&asset, "a b", 1.0)];
    let folder = tempfile::tempdir().unwrap();
    for e in ENCODINGS {
        let out = delivered(&asset, &wanted, e.name(), folder.path());
        println!("{}", out.words());
        let bytes: u64 = out.files.iter().map(|f| std::fs::metadata(f).unwrap().len()).sum();
        assert_eq!((out.encoding, out.bytes), (e.name(), bytes));
        assert!(out.files.iter().all(|f| f.is_file()) && out.skinned.p99 > 0.02);
        let goal = if e.name() == "none" { f64::MAX } else { 0.005 };
        assert!(out.residual.p99 <= goal);
        assert_eq!(out.to_json()["encoding"], e.name());
    }
    // What the last frame's OBJ and the caches hold is the trajectory, vertex by vertex.
    let text = std::fs::read_to_string(folder.path().join("frames-a_b/0018.obj")).unwrap();
    let numbers = |l: &str| -> Vec<f64> { l.split(' ').map(|w| w.parse().unwrap()).collect() };
    let lines = text.lines().filter_map(|l| l.strip_prefix("v "));
    let found: Vec<DVec3> = lines.map(|l| DVec3::from_slice(&numbers(l))).collect();
    let last = &wanted[0].trajectory.as_ref().unwrap().frames[17];
    assert!(found.len() == last.len() && found.iter().zip(last).all(|(a, b)| a.distance(*b) < 1e-6));
    let pc2 = std::fs::read(folder.path().join("cache-a_b.pc2")).unwrap();
    assert_eq!(pc2.len(), 32 + 18 * last.len() * 12);
}

#[test]
fn morph_targets_are_few_keep_weights_between_0_and_1_and_play_to_the_residual_that_is_told() {
    let asset = worm(true);
    let wanted = [soft(&asset, "slow", 0.6), soft(&asset, "fast", 1.0)];
    let folder = tempfile::tempdir().unwrap();
    let out = delivered(&asset, &wanted, "morph", folder.path());
    println!("{}", out.words());
    assert!(out.residual.p99 <= 0.005);
    let (json, bin) = document(&out.files[0]);
    let mut meshes = 0;
    for mesh in json["meshes"].as_array().unwrap() {
        let targets = mesh["primitives"][0]["targets"].as_array().map_or(0, Vec::len);
        meshes += usize::from(targets > 0);
        assert!(targets <= 8 && mesh["weights"].as_array().unwrap().len() == targets);
        assert_eq!(mesh["extras"]["targetNames"].as_array().unwrap().len(), targets);
    }
    assert_eq!(meshes, 2, "worm and hat");
    for clip in 0..2 {
        let shown: Vec<usize> = (0..json["nodes"].as_array().unwrap().len()).collect();
        let weights: Vec<_> = keys(&json, &bin, clip, &shown).into_iter().filter(|k| k.1 == "weights").collect();
        assert_eq!(weights.len(), 2);
        for (_, _, bytes) in weights {
            let floats = bytes[18 * 4..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()));
            assert!(floats.into_iter().all(|w| (0.0..=1.0).contains(&w)));
        }
    }
}

#[test]
fn motion_that_the_skin_already_has_gives_the_same_bytes_as_no_physics_at_all() {
    let asset = worm(true);
    let mut clip = soft(&asset, "clip", 0.0);
    let folder = tempfile::tempdir().unwrap();
    let plain = std::fs::read(&delivered(&asset, std::slice::from_ref(&clip), "none", folder.path()).files[0]).unwrap();
    for physics in ["rig", "morph"] {
        for trajectory in [clip.trajectory.clone(), None] {
            clip.trajectory = trajectory;
            let out = delivered(&asset, std::slice::from_ref(&clip), physics, folder.path());
            println!("{}", out.words());
            assert!(out.carrier.is_empty() && std::fs::read(&out.files[0]).unwrap() == plain);
            clip = soft(&asset, "clip", 0.0);
        }
    }
}

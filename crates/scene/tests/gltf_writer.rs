//! Each line of the GLB writer's checklist, on files read back.
#![allow(clippy::unwrap_used)]

mod common;

use animimic_scene::io::gltf::{ExportOptions, clips, write_clips};
use animimic_scene::io::{self, ReadOptions};
use animimic_scene::{Asset, Influence, Joint, Motion, Pose, Skin, Slot, Source, Transform};
use glam::{DAffine3, DMat4, DQuat, DVec3};
use serde_json::{Value, json};
use std::path::Path;

fn read(bytes: Vec<u8>) -> Asset {
    io::read_bytes(bytes, Path::new("memory.glb"), &ReadOptions::default()).unwrap()
}

fn parts(asset: &Asset) -> (&Value, &[u8]) {
    match &asset.source {
        Source::Gltf { json, buffers } => (json, &buffers[0]),
        Source::Plain => panic!("not glTF"),
    }
}

/// Floats of an accessor, tightly packed as our writer leaves them.
fn floats(asset: &Asset, accessor: &Value) -> Vec<f32> {
    let (json, bin) = parts(asset);
    let accessor = &json["accessors"][accessor.as_u64().unwrap() as usize];
    assert_eq!(accessor["componentType"], 5126);
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let start = view["byteOffset"].as_u64().unwrap_or(0) as usize;
    let bytes = &bin[start..start + view["byteLength"].as_u64().unwrap() as usize];
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// The second and later joints turn by more than a full circle about Z; the first moves; nothing else does.
fn motion(asset: &Asset, frames: usize) -> Motion {
    let pose = |f: usize| {
        let u = f as f64 / 10.0;
        let mut locals = asset.rig.skeleton.rest_locals();
        locals[0].translation += DVec3::new(0.3 * u, 0.0, 0.0);
        for local in locals.iter_mut().skip(1) {
            // Both signs of the same rotation in turn: the writer has to make them continuous.
            let turn = DQuat::from_rotation_z(1.3 * u);
            local.rotation *= if f.is_multiple_of(2) { turn } else { -turn };
        }
        Pose { locals }
    };
    Motion { name: "wave".into(), fps: 24.0, poses: (0..frames).map(pose).collect() }
}

fn export(asset: &Asset, options: &ExportOptions) -> Asset {
    read(write_clips(asset, &[motion(asset, 40)], options).unwrap())
}

/// A plain asset with two roots and awkward names.
fn plain() -> Asset {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 1 2 0\nv 0 2 0\nf 1 2 3 4\nf 4 3 5 6\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    std::fs::write(&path, text).unwrap();
    let mut asset = io::read(&path).unwrap();
    attach_chain(&mut asset);
    asset
}

fn attach_chain(asset: &mut Asset) {
    let joint = |name: &str, parent, t: [f64; 3]| Joint {
        name: name.into(),
        parent,
        rest: Transform { translation: t.into(), rotation: DQuat::from_rotation_z(0.3), ..Transform::IDENTITY },
        node: None,
    };
    asset.rig.skeleton.joints = vec![
        joint("leg.L", None, [0.5, 0.0, 0.0]),
        joint("leg.L", Some(0), [0.0, 1.0, 0.0]),
        joint("a:b/[c] d", None, [0.0, 2.0, 0.0]),
    ];
    let world = asset.rig.skeleton.rest_world();
    let weights = |p: &DVec3| {
        let w = [0.5 + 0.1 * p.x, 0.2 + 0.1 * p.y, 0.1, 0.05, 0.15 - 0.01 * p.z];
        let sum: f64 = w.iter().sum();
        // Five influences, two of them of one joint through different slots.
        w.iter().enumerate().map(|(k, w)| Influence { slot: [0, 1, 2, 0, 1][k], weight: w / sum }).collect()
    };
    asset.rig.skin = Skin {
        slots: world.iter().enumerate().map(|(joint, w)| Slot { joint, inverse_bind: w.inverse() }).collect(),
        bind_positions: asset.mesh.positions.clone(),
        influences: asset.mesh.positions.iter().map(weights).collect(),
    };
}

fn worst_distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

#[test]
fn a_given_rig_keeps_its_nodes_order_and_buffers_and_skinned_meshes_go_to_the_root() {
    let document = common::creature();
    let input = read(document.glb());
    let output = export(&input, &ExportOptions::default());
    let (json, bin) = parts(&output);
    assert_eq!(&bin[..document.bin.len()], &document.bin[..], "original buffer, byte for byte");
    let names: Vec<&str> = json["nodes"].as_array().unwrap().iter().map(|n| n["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["parent", "body", "hip", "knee.L", "prop"]);
    assert_eq!(json["scenes"][0]["nodes"], json!([0, 1]));
    assert_eq!(json["nodes"][0]["children"], json!([2]));
    assert!(["translation", "rotation", "scale", "matrix"].iter().all(|k| json["nodes"][1].get(*k).is_none()));
    for i in [0, 2, 4] {
        for key in ["translation", "rotation", "scale"] {
            assert_eq!(json["nodes"][i].get(key), document.json["nodes"][i].get(key), "node {i} {key}");
        }
    }
    for key in ["skins", "meshes", "materials", "extensionsUsed"] {
        assert_eq!(json[key], document.json[key], "{key}");
    }
    assert_eq!(json.get("extensionsRequired"), None);
    assert_eq!(json["nodes"][1]["extras"]["tag"], "kept");
    assert_eq!(json["scenes"][0]["extras"]["mood"], "kept");
}

#[test]
fn output_stands_exactly_where_the_input_stood() {
    let input = read(common::creature().glb());
    let output = export(&input, &ExportOptions::default());
    assert_eq!(output.mesh.positions, input.mesh.positions);
    assert_eq!(output.mesh.triangles, input.mesh.triangles);
    // Parent: turn +Z to +X, scale 2, shift (1, 2, 3); hip at the origin turned by 0.2 rad about Z.
    let hip = DQuat::from_xyzw(0.0, 0.0, 0.1, 0.994_987_437_106_62).normalize();
    let expected =
        DVec3::new(1.0, 2.0, 3.0) + DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2) * (hip * DVec3::X) * 2.0;
    let error = input.mesh.positions[1].distance(expected);
    assert!(error < 1e-12, "{error}");
}

#[test]
fn a_motion_comes_back_from_the_file_to_float_precision() {
    let input = read(common::creature().glb());
    let motion = motion(&input, 40);
    let output = read(write_clips(&input, std::slice::from_ref(&motion), &ExportOptions::default()).unwrap());
    let clip = &clips(&output).unwrap()[0];
    assert_eq!(clip.name, "wave");
    let mut worst: f64 = 0.0;
    for (f, pose) in motion.poses.iter().enumerate() {
        let read = clip.pose(&output.rig.skeleton, f as f64 / motion.fps);
        let ours = input.rig.in_pose(pose);
        let theirs = output.rig.in_pose(&read);
        worst = worst.max(worst_distance(&ours, &theirs) / input.mesh.diagonal());
    }
    println!("worst {worst:.2e} of the diagonal");
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn samplers_start_at_zero_increase_share_their_input_turn_continuously_and_only_move_what_moves() {
    let input = read(common::creature().glb());
    let output = export(&input, &ExportOptions { keep_clips: false, ..ExportOptions::default() });
    let (json, _) = parts(&output);
    assert_eq!(json["animations"].as_array().unwrap().len(), 1);
    let animation = &json["animations"][0];
    let samplers = animation["samplers"].as_array().unwrap();
    assert!(samplers.iter().all(|s| s["input"] == samplers[0]["input"] && s["interpolation"] == "LINEAR"));
    let times = floats(&output, &samplers[0]["input"]);
    assert!(times[0] == 0.0 && times.windows(2).all(|w| w[0] < w[1]), "{times:?}");
    let accessor = &json["accessors"][samplers[0]["input"].as_u64().unwrap() as usize];
    assert_eq!(
        (accessor["min"][0].as_f64(), accessor["max"][0].as_f64()),
        (Some(0.0), times.last().map(|t| f64::from(*t)))
    );
    let channels: Vec<(u64, &str)> = animation["channels"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| (c["target"]["node"].as_u64().unwrap(), c["target"]["path"].as_str().unwrap()))
        .collect();
    assert_eq!(channels, [(0, "translation"), (2, "rotation"), (3, "rotation"), (4, "rotation")]);
    for sampler in &samplers[1..] {
        let q = floats(&output, &sampler["output"]);
        for pair in q.chunks_exact(4).collect::<Vec<_>>().windows(2) {
            let dot: f32 = pair[0].iter().zip(pair[1]).map(|(a, b)| a * b).sum();
            assert!(dot > 0.9, "neighbouring quaternions {pair:?}");
        }
        assert!(q.chunks_exact(4).all(|q| (q.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-6));
    }
    assert!(json["nodes"][3].get("matrix").is_none(), "animated nodes have no matrix");
}

#[test]
fn what_moves_in_one_of_several_clips_has_a_channel_in_all_of_them() {
    let input = read(common::creature().glb());
    let still = Pose { locals: input.rig.skeleton.rest_locals() };
    let still = Motion { name: "still".into(), fps: 24.0, poses: vec![still; 3] };
    let mut nod = Motion { name: "nod".into(), poses: still.poses.clone(), ..still.clone() };
    nod.poses.iter_mut().enumerate().for_each(|(f, p)| p.locals[1].scale *= 1.0 + 0.1 * f as f64);
    let options = ExportOptions { keep_clips: false, ..ExportOptions::default() };
    let output = read(write_clips(&input, &[motion(&input, 5), still, nod], &options).unwrap());
    let targets = |k: usize| -> Vec<String> {
        let channels = parts(&output).0["animations"][k]["channels"].as_array().unwrap().clone();
        let mut all: Vec<String> = channels.iter().map(|c| c["target"].to_string()).collect();
        all.sort();
        all
    };
    println!("{:?}", targets(0));
    assert_eq!(targets(0).len(), 5, "four of the wave, one of the nod");
    assert!(targets(0) == targets(1) && targets(1) == targets(2));
    let clips = clips(&output).unwrap();
    let rest = input.rig.skeleton.rest_locals();
    for (held, joint) in [(&clips[1], 2), (&clips[2], 2)] {
        let local = held.pose(&output.rig.skeleton, 0.05).locals[joint];
        assert!((local.rotation.dot(rest[joint].rotation).abs() - 1.0).abs() < 1e-6, "{}", held.name);
    }
}

#[test]
fn a_motion_that_stands_still_is_a_valid_clip() {
    let input = read(common::creature().glb());
    let still =
        Motion { name: "still".into(), fps: 24.0, poses: vec![Pose { locals: input.rig.skeleton.rest_locals() }; 3] };
    let output = read(write_clips(&input, &[still], &ExportOptions::default()).unwrap());
    let clip = &clips(&output).unwrap()[0];
    assert_eq!(clip.name, "still");
    assert_eq!(
        clip.pose(&output.rig.skeleton, 0.05).locals[0].translation,
        input.rig.skeleton.joints[0].rest.translation
    );
}

#[test]
fn old_clips_are_kept_behind_the_new_ones_or_replaced() {
    let input = read(common::creature().glb());
    let names = |asset: &Asset| -> Vec<String> { clips(asset).unwrap().iter().map(|c| c.name.clone()).collect() };
    assert_eq!(names(&export(&input, &ExportOptions::default())), ["wave", "old"]);
    assert_eq!(names(&export(&input, &ExportOptions { keep_clips: false, ..ExportOptions::default() })), ["wave"]);
    let twice = [motion(&input, 3), motion(&input, 5)];
    assert_eq!(
        names(&read(write_clips(&input, &twice, &ExportOptions::default()).unwrap())),
        ["wave", "wave_1", "old"]
    );
}

#[test]
fn clips_are_sampled_by_the_rules_of_their_interpolation() {
    let asset = read(common::creature().glb());
    let clip = &clips(&asset).unwrap()[0];
    let hip = asset.rig.skeleton.joints.iter().position(|j| j.name == "hip").unwrap();
    let at = |t: f64| clip.pose(&asset.rig.skeleton, t).locals[hip];
    let angle = |q: DQuat| 2.0 * q.z.atan2(q.w);
    assert!((angle(at(0.25).rotation) - std::f64::consts::FRAC_PI_4).abs() < 1e-6, "{}", angle(at(0.25).rotation));
    assert_eq!(at(0.49).translation, DVec3::ZERO);
    assert_eq!(at(0.5).translation, DVec3::Y);
    assert_eq!(clip.motion(&asset.rig.skeleton, 30.0).unwrap().poses.len(), 31);
}

#[test]
fn a_made_rig_is_one_joint_tree_with_safe_unique_names_and_rigid_inverse_binds() {
    let input = plain();
    let output = export(&input, &ExportOptions::default());
    let (json, _) = parts(&output);
    let skin = &json["skins"][0];
    let joints: Vec<u64> = skin["joints"].as_array().unwrap().iter().map(|j| j.as_u64().unwrap()).collect();
    let nodes = json["nodes"].as_array().unwrap();
    let mut names: Vec<&str> = nodes.iter().map(|n| n["name"].as_str().unwrap()).collect();
    assert!(names.iter().all(|n| !n.contains(['[', ']', '.', ':', '/', ' '])), "{names:?}");
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), nodes.len());
    // One root at the scene's root beside the mesh; everything under it is a joint.
    let roots = json["scenes"][0]["nodes"].as_array().unwrap();
    assert_eq!(roots.len(), 2);
    let mesh = roots.iter().map(|r| &nodes[r.as_u64().unwrap() as usize]).find(|n| n.get("mesh").is_some()).unwrap();
    assert!(["translation", "rotation", "scale", "matrix", "children"].iter().all(|k| mesh.get(*k).is_none()));
    let root = roots[1].as_u64().unwrap();
    assert_eq!(skin["skeleton"], root);
    let (mut stack, mut tree) = (vec![root], Vec::new());
    while let Some(i) = stack.pop() {
        assert!(joints.contains(&i), "node {i} is no joint");
        tree.push(i);
        stack.extend(nodes[i as usize]["children"].as_array().into_iter().flatten().map(|c| c.as_u64().unwrap()));
    }
    assert_eq!(tree.len(), joints.len());
    assert!(
        joints.iter().all(|&j| nodes[j as usize].get("scale").is_none() && nodes[j as usize].get("matrix").is_none())
    );
    let world = output.rig.skeleton.rest_world();
    for (m, &j) in floats(&output, &skin["inverseBindMatrices"]).chunks_exact(16).zip(&joints) {
        let bind = DAffine3::from_mat4(DMat4::from_cols_slice(&m.iter().map(|x| f64::from(*x)).collect::<Vec<_>>()));
        assert!((bind.matrix3.determinant() - 1.0).abs() < 1e-6);
        if let Some(k) = output.rig.skeleton.joints.iter().position(|joint| joint.node == Some(j as usize)) {
            assert!((world[k] * bind).abs_diff_eq(DAffine3::IDENTITY, 1e-6), "joint {k}");
        }
    }
    let error = worst_distance(&output.mesh.positions, &input.mesh.positions);
    assert!(error < 1e-6, "{error}");
}

#[test]
fn a_made_rig_has_four_influences_that_sum_to_one_with_no_joint_twice() {
    let output = export(&plain(), &ExportOptions::default());
    let (json, bin) = parts(&output);
    let attributes = &json["meshes"][0]["primitives"][0]["attributes"];
    assert_eq!(json["accessors"][attributes["JOINTS_0"].as_u64().unwrap() as usize]["componentType"], 5121);
    assert!(attributes.get("JOINTS_1").is_none());
    let weights = floats(&output, &attributes["WEIGHTS_0"]);
    let view = &json["bufferViews"]
        [json["accessors"][attributes["JOINTS_0"].as_u64().unwrap() as usize]["bufferView"].as_u64().unwrap() as usize];
    let joints = &bin[view["byteOffset"].as_u64().unwrap() as usize..][..weights.len()];
    for (w, j) in weights.chunks_exact(4).zip(joints.chunks_exact(4)) {
        assert_eq!(w.iter().sum::<f32>(), 1.0);
        for k in 0..4 {
            assert!(w[k] >= 0.0 && (w[k] > 0.0 || j[k] == 0), "{w:?} {j:?}");
            assert!(w[k] == 0.0 || (0..k).all(|i| w[i] == 0.0 || j[i] != j[k]), "{w:?} {j:?}");
        }
    }
}

#[test]
fn a_rig_made_for_an_unrigged_glb_under_transformed_parents_stands_where_it_stood() {
    let mut document = common::creature();
    // No skin: the strip becomes rigid under its own node, mirrored for good measure.
    document.json["nodes"][1].as_object_mut().unwrap().shift_remove("skin");
    document.json["nodes"][1]["scale"] = json!([-1.0, 1.0, 1.0]);
    let mut input = read(document.glb());
    attach_chain(&mut input);
    let output = export(&input, &ExportOptions::default());
    let error = worst_distance(&output.mesh.positions, &input.mesh.positions) / input.mesh.diagonal();
    assert!(error < 1e-6, "{error}");
    assert_eq!(output.mesh.triangles, input.mesh.triangles);
    let (json, bin) = parts(&output);
    assert_eq!(&bin[..document.bin.len()], &document.bin[..]);
    assert_eq!(json["materials"], document.json["materials"]);
    let attributes = &json["meshes"][0]["primitives"][0]["attributes"];
    assert_eq!(attributes["TEXCOORD_0"], document.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]);
    assert_eq!(clips(&output).unwrap().len(), 1, "clips of the replaced hierarchy are gone");
    let motion = motion(&input, 40);
    let clip = &clips(&output).unwrap()[0];
    let pose = clip.pose(&output.rig.skeleton, 20.0 / 24.0);
    let theirs = output.rig.in_pose(&pose);
    let four = |a: &Asset| a.rig.in_pose(&motion.poses[20]);
    let error = worst_distance(&theirs, &four(&input)) / input.mesh.diagonal();
    println!("posed: {error:.2e} of the diagonal");
    assert!(error < 1e-6, "{error}");
}

#[test]
fn run_information_goes_to_the_asset_extras_beside_what_is_there() {
    let input = read(common::creature().glb());
    let options = ExportOptions { extras: json!({ "version": "1", "seed": 7 }), ..ExportOptions::default() };
    let output = export(&input, &options);
    let (json, _) = parts(&output);
    assert_eq!(json["asset"]["extras"], json!({ "artist": "kept", "animimic": { "version": "1", "seed": 7 } }));
}

#[test]
fn a_textured_obj_comes_back_with_its_pixels_colour_and_seams() {
    let folder = tempfile::tempdir().unwrap();
    let rgb: Vec<u8> = (0..4 * 3 * 3).map(|i| (i * 7) as u8).collect();
    image::RgbImage::from_raw(4, 3, rgb.clone()).unwrap().save(folder.path().join("t.png")).unwrap();
    std::fs::write(folder.path().join("a.mtl"), "newmtl m\nKd 0.5 1 1\nmap_Kd t.png\n").unwrap();
    let text = "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/4 3/3 4/1\n";
    std::fs::write(folder.path().join("a.obj"), text).unwrap();
    let input = io::read(folder.path().join("a.obj")).unwrap();
    let output = export(&input, &ExportOptions::default());
    let texture = output.looks[0].texture.as_ref().unwrap();
    assert_eq!(texture.image.rgb.concat(), rgb);
    assert_eq!(output.looks[0].base_color, input.looks[0].base_color);
    assert_eq!((output.mesh.positions.len(), output.mesh.welded_count), (5, 4));
    assert_eq!(output.mesh.uvs, input.mesh.uvs);
}

#[test]
fn a_skinned_node_with_children_leaves_them_in_their_place() {
    let mut document = common::creature();
    document.json["nodes"][1]["children"] = json!([5]);
    document.json["nodes"].as_array_mut().unwrap().push(json!({ "name": "hat", "mesh": 1 }));
    let input = read(document.glb());
    let output = export(&input, &ExportOptions::default());
    assert_eq!(output.mesh.positions, input.mesh.positions);
    let (json, _) = parts(&output);
    assert_eq!(json["nodes"][1].get("children"), None);
    assert_eq!(json["nodes"][6]["children"], json!([5]));
    assert_eq!(json["nodes"][0]["children"], json!([6, 2]));
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let input = read(common::creature().glb());
    let bytes = || write_clips(&input, &[motion(&input, 10)], &ExportOptions::default()).unwrap();
    assert_eq!(bytes(), bytes());
    assert_eq!(bytes().len() % 4, 0);
}

#[test]
fn motions_that_do_not_fit_are_refused() {
    let input = read(common::creature().glb());
    let good = motion(&input, 3);
    let mut short = good.clone();
    short.poses[1].locals.pop();
    let mut broken = good.clone();
    broken.poses[2].locals[0].translation.x = f64::NAN;
    for (bad, part) in [
        (short, "frame 1"),
        (broken, "not finite in frame 2"),
        (Motion { poses: Vec::new(), ..good.clone() }, "no frames"),
        (Motion { fps: 0.0, ..good.clone() }, "frames per second"),
    ] {
        let message = write_clips(&input, &[bad], &ExportOptions::default()).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
}

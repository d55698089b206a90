//! What glTF files may contain, one feature a test, on variations of one small creature.
#![allow(clippy::unwrap_used)]

mod common;

use animimic_scene::io::gltf::{ExportOptions, clips, write_clips};
use animimic_scene::io::{self, ReadOptions};
use animimic_scene::{AlphaMode, Asset};
use common::Document;
use glam::{DVec2, DVec3};
use serde_json::json;
use std::path::Path;

fn read(document: &Document) -> Asset {
    io::read_bytes(document.glb(), Path::new("memory.glb"), &ReadOptions::default()).unwrap()
}

/// The rigid triangle's part of an asset (the second part).
fn prop(asset: &Asset) -> &[[u32; 3]] {
    &asset.mesh.triangles[asset.mesh.parts[1].triangles.clone()]
}

#[test]
fn strips_and_fans_become_triangles_of_one_orientation() {
    let mut d = common::creature();
    let square = d.floats("VEC3", 3, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0]);
    d.json["meshes"][1]["primitives"][0] = json!({ "mode": 5, "attributes": { "POSITION": square } });
    assert_eq!(prop(&read(&d)), [[8, 9, 10], [10, 9, 11]]);
    d.json["meshes"][1]["primitives"][0]["mode"] = json!(6);
    assert_eq!(prop(&read(&d)), [[8, 9, 10], [8, 10, 11]]);
    d.json["meshes"][1]["primitives"][0]["mode"] = json!(1);
    let lines = read(&d);
    assert_eq!(lines.mesh.parts.len(), 1);
    assert!(lines.warnings[0].contains("points or lines"), "{:?}", lines.warnings);
}

#[test]
fn sparse_accessors_replace_what_they_name() {
    let mut d = common::creature();
    let indices = d.accessor(&[2], json!({}));
    let values = d.floats("VEC3", 3, &[0.25, 0.5, 0.75]);
    let views = [indices, values].map(|a| d.json["accessors"][a]["bufferView"].clone());
    let target = d.json["meshes"][1]["primitives"][0]["attributes"]["POSITION"].as_u64().unwrap() as usize;
    d.json["accessors"][target]["sparse"] = json!({ "count": 1,
        "indices": { "bufferView": views[0], "componentType": 5121 }, "values": { "bufferView": views[1] } });
    d.json["accessors"].as_array_mut().unwrap()[indices] =
        json!({ "componentType": 5126, "type": "SCALAR", "count": 1 });
    let asset = read(&d);
    assert_eq!(asset.rig.skin.bind_positions[10], DVec3::new(0.25, 0.5, 0.75));
}

#[test]
fn quantised_positions_and_weights_are_normalised_as_they_say() {
    let mut d = common::creature();
    let bytes: Vec<u8> =
        [[0i16, 0, 0], [32767, 0, 0], [0, -32768, 16384]].iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    let position = d.accessor(&bytes, json!({ "componentType": 5122, "normalized": true, "type": "VEC3", "count": 3 }));
    d.json["meshes"][1]["primitives"][0]["attributes"]["POSITION"] = json!(position);
    d.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let weights: Vec<u8> = (0..8).flat_map(|_| [51u8, 204, 0, 0]).collect();
    let weights =
        d.accessor(&weights, json!({ "componentType": 5121, "normalized": true, "type": "VEC4", "count": 8 }));
    d.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(weights);
    let asset = read(&d);
    assert_eq!(asset.rig.skin.bind_positions[9], DVec3::X);
    assert_eq!(asset.rig.skin.bind_positions[10], DVec3::new(0.0, -1.0, 16384.0 / 32767.0));
    assert!((asset.rig.skin.influences[0][0].weight - 0.8).abs() < 1e-12);
}

#[test]
fn a_second_set_of_influences_adds_to_the_first() {
    let mut d = common::creature();
    let weights: Vec<f32> = (0..8).flat_map(|_| [0.5, 0.0, 0.0, 0.0]).collect();
    let joints: Vec<u8> = (0..8).flat_map(|_| [1, 0, 0, 0]).collect();
    let w = d.floats("VEC4", 4, &weights);
    let j = d.accessor(&joints, json!({ "componentType": 5121, "type": "VEC4", "count": 8 }));
    let attributes = &mut d.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_1"] = json!(j);
    attributes["WEIGHTS_1"] = json!(w);
    let asset = read(&d);
    let joint = |v: usize, k: usize| {
        let i = asset.rig.skin.influences[v][k];
        (asset.rig.skeleton.joints[asset.rig.skin.slots[i.slot as usize].joint].name.as_str(), i.weight)
    };
    assert_eq!(joint(0, 0), ("hip", 1.0 / 1.5));
    assert_eq!(joint(0, 1), ("knee.L", 0.5 / 1.5));
    assert_eq!(joint(7, 0), ("knee.L", 1.0));
}

#[test]
fn texture_transforms_are_baked_into_the_coordinates_of_the_set_they_name() {
    let mut d = common::creature();
    let png = {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image::RgbImage::from_pixel(2, 2, image::Rgb([9, 8, 7])).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    };
    let accessor = d.accessor(&png, json!({ "componentType": 5121, "type": "SCALAR", "count": 1 }));
    d.json["images"] = json!([{ "bufferView": d.json["accessors"][accessor]["bufferView"], "mimeType": "image/png" }]);
    d.json["samplers"] = json!([{ "wrapS": 33071, "magFilter": 9728 }]);
    d.json["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    let quarter = std::f64::consts::FRAC_PI_2;
    d.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0, "texCoord": 3, "extensions": {
        "KHR_texture_transform": { "offset": [0.5, 0.25], "rotation": quarter, "scale": [2.0, 4.0], "texCoord": 0 } } });
    d.json["materials"][0]["alphaMode"] = json!("MASK");
    let asset = read(&d);
    let texture = asset.looks[0].texture.as_ref().unwrap();
    assert_eq!((texture.image.at(1, 1), texture.repeat, texture.nearest), ([9, 8, 7], [false, true], true));
    assert_eq!(asset.looks[0].alpha, AlphaMode::Mask(0.5));
    // The extension's rotation turns uv (1, 0) to (cos, −sin): vertex 1 has uv (1, 0), scaled (2, 0), turned (0, −2), shifted (0.5, −1.75).
    assert!(asset.mesh.uvs[1].distance(DVec2::new(0.5, -1.75)) < 1e-12, "{}", asset.mesh.uvs[1]);
}

#[test]
fn cubic_splines_follow_the_hermite_formula() {
    let mut d = common::creature();
    let time = d.floats("SCALAR", 1, &[0.0, 2.0]);
    // In-tangent, value, out-tangent per key.
    let values = [[0.0; 3], [1.0, 0.0, 0.0], [0.5, 0.0, 0.0], [-1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0; 3]].concat();
    let output = d.floats("VEC3", 3, &values);
    d.json["animations"] = json!([{ "samplers": [{ "input": time, "output": output, "interpolation": "CUBICSPLINE" }],
        "channels": [{ "sampler": 0, "target": { "node": 2, "path": "translation" } }] }]);
    let asset = read(&d);
    let clip = &clips(&asset).unwrap()[0];
    let hip = asset.rig.skeleton.joints.iter().position(|j| j.name == "hip").unwrap();
    let x = |t: f64| clip.pose(&asset.rig.skeleton, t).locals[hip].translation.x;
    // Hermite at u = 1/2: (p0 + p1)/2 + span (m0 − m1)/8.
    assert_eq!((x(-1.0), x(0.0), x(1.0), x(2.0), x(9.0)), (1.0, 1.0, 2.0 + 2.0 * 1.5 / 8.0, 3.0, 3.0));
    assert_eq!(clip.name, "clip_0");
}

#[test]
fn external_buffers_and_pictures_are_loaded_and_written_into_the_glb() {
    let mut d = common::creature();
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("a picture.png");
    image::RgbImage::from_pixel(3, 1, image::Rgb([1, 2, 3])).save(&picture).unwrap();
    std::fs::write(folder.path().join("data.bin"), &d.bin).unwrap();
    d.json["buffers"] = json!([{ "byteLength": d.bin.len(), "uri": "data.bin" }]);
    d.json["images"] = json!([{ "uri": "a%20picture.png" }]);
    d.json["textures"] = json!([{ "source": 0 }]);
    d.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    let path = folder.path().join("a.gltf");
    std::fs::write(&path, d.json.to_string()).unwrap();
    let asset = io::read(&path).unwrap();
    assert_eq!(asset.looks[0].texture.as_ref().unwrap().image.at(2, 0), [1, 2, 3]);
    let written = write_clips(&asset, &[], &ExportOptions::default()).unwrap();
    let bytes = std::fs::read(&picture).unwrap();
    assert!(written.windows(bytes.len()).any(|w| w == bytes), "the picture's own bytes");
    let again = io::read_bytes(written, Path::new("elsewhere.glb"), &ReadOptions::default()).unwrap();
    assert_eq!(again.mesh.positions, asset.mesh.positions);
    assert!(again.looks[0].texture.is_some());
    d.json["buffers"][0]["uri"] = json!("../outside.bin");
    std::fs::write(&path, d.json.to_string()).unwrap();
    assert!(io::read(&path).unwrap_err().to_string().contains("outside the model's folder"));
}

#[test]
fn morph_weights_of_the_file_are_part_of_the_rest_shape() {
    let mut d = common::creature();
    let offset = d.floats("VEC3", 3, &[0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    d.json["meshes"][1]["primitives"][0]["targets"] = json!([{ "POSITION": offset }]);
    d.json["meshes"][1]["weights"] = json!([0.5]);
    assert_eq!(read(&d).rig.skin.bind_positions[8], DVec3::new(0.0, 0.0, 0.5));
    d.json["nodes"][4]["weights"] = json!([0.25]);
    assert_eq!(read(&d).rig.skin.bind_positions[8], DVec3::new(0.0, 0.0, 0.25));
}

#[test]
fn only_the_default_scene_is_shown() {
    let mut d = common::creature();
    d.json["nodes"].as_array_mut().unwrap().push(json!({ "name": "hidden", "mesh": 1 }));
    let asset = read(&d);
    assert_eq!(asset.mesh.parts.len(), 2);
    assert!(asset.warnings[0].contains("not part of the default scene"), "{:?}", asset.warnings);
}

//! Seeded mutations of every file that is read here: no panic, no hang, less than a gibibyte, and what is accepted is sound.
//!
//! With `video/tests/fuzz.rs` over 40 000 cases. What once failed stands as a test of its own, with its bytes.
#![allow(clippy::unwrap_used)]

mod common;
#[path = "common/mutate.rs"]
mod mutate;
#[path = "common/repack.rs"]
mod repack;

use animimic_scene::Asset;
use animimic_scene::io::{self, ReadOptions, SceneError};
use common::Document;
use mutate::{Random, hammer, hammer_with, in_a_small_child, mutated, mutated_json};
use serde_json::json;
use std::path::Path;

/// Reads as a file of that name; what is accepted must hold together and be writable, what is refused be told on one line.
fn sound(bytes: Vec<u8>, name: &str, repair: bool) -> bool {
    let asset: Asset = match io::read_bytes(bytes, Path::new(name), &ReadOptions { repair }) {
        Ok(asset) => asset,
        Err(e) => {
            assert!(e.to_string().lines().count() <= 1, "{e}");
            return false;
        }
    };
    let n = asset.mesh.positions.len();
    assert!(asset.mesh.triangles.iter().flatten().all(|&i| (i as usize) < n));
    assert!(asset.mesh.positions.iter().all(|p| p.is_finite()));
    let slots = asset.rig.skin.slots.len();
    assert!(asset.rig.skin.influences.iter().all(|l| !l.is_empty() && l.iter().all(|i| (i.slot as usize) < slots)));
    if let Ok(clips) = io::gltf::clips(&asset) {
        clips.iter().for_each(|c| drop(c.pose(&asset.rig.skeleton, 0.3)));
    }
    let written = io::gltf::write_clips(&asset, &[], &Default::default()).unwrap();
    let again = io::read_bytes(written, Path::new("again.glb"), &ReadOptions::default());
    assert!(again.is_ok(), "what was accepted is not read again: {}", again.unwrap_err());
    true
}

/// The creature with all that a reader must follow: a sparse accessor, morph targets, a second set of weights, a spline, a picture.
fn rich() -> Document {
    let mut d = common::creature();
    let png = picture(image::ColorType::Rgb8);
    let view = {
        let accessor = d.accessor(&png, json!({}));
        d.json["accessors"].as_array_mut().unwrap().remove(accessor)["bufferView"].clone()
    };
    d.json["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    d.json["samplers"] = json!([{ "wrapS": 33071, "magFilter": 9728 }]);
    d.json["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    d.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] =
        json!({ "index": 0, "extensions": { "KHR_texture_transform": { "offset": [0.5, 0], "rotation": 0.3 } } });
    let target = d.floats("VEC3", 3, &[0.1; 24]);
    let view = |d: &mut Document, bytes: &[u8]| {
        let accessor = d.accessor(bytes, json!({}));
        d.json["accessors"].as_array_mut().unwrap().remove(accessor)["bufferView"].clone()
    };
    let indices = view(&mut d, &[1, 3]);
    let values = view(&mut d, &[0u8; 24]);
    d.json["accessors"][target]["sparse"] = json!({ "count": 2, "indices": { "bufferView": indices, "componentType": 5121 }, "values": { "bufferView": values } });
    let joints = d.accessor(&[0; 32], json!({ "componentType": 5121, "type": "VEC4", "count": 8 }));
    let weights =
        d.accessor(&[0; 32], json!({ "componentType": 5121, "normalized": true, "type": "VEC4", "count": 8 }));
    let primitive = &mut d.json["meshes"][0]["primitives"][0];
    primitive["targets"] = json!([{ "POSITION": target }]);
    (primitive["attributes"]["JOINTS_1"], primitive["attributes"]["WEIGHTS_1"]) = (json!(joints), json!(weights));
    d.json["meshes"][0]["weights"] = json!([0.5]);
    let spline: Vec<f32> = (0..27).map(|i| i as f32 / 27.0).collect();
    let output = d.floats("VEC3", 3, &spline);
    d.json["animations"][0]["samplers"][1]["output"] = json!(output);
    d.json["animations"][0]["samplers"][1]["interpolation"] = json!("CUBICSPLINE");
    d
}

/// Quantised positions in a stream of meshoptimizer's own encoder (the one of the decoder's tests), drawn as a strip.
fn compressed() -> Vec<u8> {
    const STREAM: &str = "a00000152aaaaaaaaaaaaaaaaaaa00002a0444444444444444444444444444444444444444000000002a0666666666666666\
        666666666666666666666666000000001f000c243c546c849cb4cce4fcebd3bba38b735b432b13041c344c647c94acc4dcff\
        ff0000f4f3dbc3ab937b631f000e2a46627e9ab6d2eef5d9bda185694d311506223e5a7692aecae6fde1c5a9ffdf00008d71\
        55391d1a361f001030507090b0d0f0efcfaf8f6f4f2f0f1030507090b0d0f0efcfaf8f6f4f2fffff00000f1030507090b0d0\
        00000000000000000000000000000000000000000000000000000000000f1215";
    let bin: Vec<u8> =
        (0..STREAM.len() / 2).map(|i| u8::from_str_radix(&STREAM[2 * i..2 * i + 2], 16).unwrap()).collect();
    let extension = json!({ "buffer": 0, "byteLength": bin.len(), "byteStride": 8, "count": 40, "mode": "ATTRIBUTES" });
    let json = json!({
        "asset": { "version": "2.0" }, "scenes": [{ "nodes": [0] }], "scene": 0, "nodes": [{ "mesh": 0 }],
        "extensionsRequired": ["EXT_meshopt_compression", "KHR_mesh_quantization"],
        "buffers": [{ "byteLength": bin.len() },
            { "byteLength": 320, "extensions": { "EXT_meshopt_compression": { "fallback": true } } }],
        "bufferViews": [{ "buffer": 1, "byteLength": 320, "byteStride": 8, "extensions": { "EXT_meshopt_compression": extension } }],
        "accessors": [{ "bufferView": 0, "componentType": 5122, "type": "VEC3", "count": 40 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "mode": 5 }] }],
    });
    Document { json, bin }.glb()
}

/// A small picture of some kind of pixels.
fn picture(kind: image::ColorType) -> Vec<u8> {
    let bytes: Vec<u8> = (0..16 * 16 * usize::from(kind.bytes_per_pixel())).map(|i| (i * 37 % 251) as u8).collect();
    let mut out = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut out);
    image::ImageEncoder::write_image(encoder, &bytes, 16, 16, kind.into()).unwrap();
    out
}

/// A model whose texture is this file.
fn wearing(picture: &[u8], mime: &str) -> Vec<u8> {
    let mut d = common::creature();
    let accessor = d.accessor(picture, json!({}));
    let view = d.json["accessors"].as_array_mut().unwrap().remove(accessor)["bufferView"].clone();
    d.json["images"] = json!([{ "bufferView": view, "mimeType": mime }]);
    d.json["textures"] = json!([{ "source": 0 }]);
    d.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    d.glb()
}

#[test]
fn mutated_gltf_files_never_panic_hang_or_give_unsound_models() {
    if !in_a_small_child("mutated_gltf_files_never_panic_hang_or_give_unsound_models", 60) {
        return;
    }
    let binary = [common::creature().glb(), rich().glb(), compressed()];
    hammer("glb", &binary, 3600, |b| sound(b, "a.glb", false));
    hammer("glb with repair", &binary, 1500, |b| sound(b, "a.glb", true));
    let documents = [common::creature(), rich()];
    let data = |d: &Document, random: &mut Random| {
        let mut d = d.clone();
        let length = d.bin.len();
        d.bin = mutated(&d.bin, random);
        d.bin.resize(length, 0);
        d.glb()
    };
    let document =
        |d: &Document, random: &mut Random| Document { json: mutated_json(&d.json, random), bin: d.bin.clone() }.glb();
    hammer_with("glb by its data", &documents, 2000, data, |b| sound(b, "a.glb", false));
    hammer_with("glb by its JSON", &documents, 6000, document, |b| sound(b, "a.glb", false));
    hammer_with("glb by its JSON with repair", &documents, 3000, document, |b| sound(b, "a.glb", true));
    let inline = |mut d: Document| {
        use base64::Engine;
        let data = base64::engine::general_purpose::STANDARD.encode(&d.bin);
        let uri = format!("data:application/octet-stream;base64,{data}");
        d.json["buffers"] = json!([{ "byteLength": d.bin.len(), "uri": uri }]);
        d.json.to_string().into_bytes()
    };
    hammer("gltf", &[inline(common::creature()), inline(rich())], 3000, |b| sound(b, "a.gltf", false));
}

#[test]
fn mutated_plain_models_never_panic_hang_or_give_unsound_models() {
    if !in_a_small_child("mutated_plain_models_never_panic_hang_or_give_unsound_models", 60) {
        return;
    }
    let obj = "mtllib m.mtl\no a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\nvt 0 0\nvt 1 1\nvn 0 0 1\nusemtl x\nf 1/1/1 2/2/1 3/1/1 4/2/1\nf -1//1 -2//1 -3//1\n";
    let off =
        "COFF\n4 2 0\n0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n1 1 0 0 0 255 255\n0 1 1 9 9 9 255\n3 0 1 2\n3 0 2 3\n";
    let words = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1.5 0\nendloop\nendfacet\nendsolid a\n";
    let mut stl = vec![0u8; 80];
    stl.extend(2u32.to_le_bytes());
    stl.extend((0..2).flat_map(|k| (0..12).flat_map(move |i| ((i * i + k) as f32).to_le_bytes()).chain([0, 0])));
    let head = |form: &str| {
        format!(
            "ply\nformat {form} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let ascii = head("ascii") + "0 0 0 1 2 3\n1 0 0 4 5 6\n0 1 0 7 8 9\n3 0 1 2\n";
    let binary = |little: bool| {
        let mut out = head(if little { "binary_little_endian" } else { "binary_big_endian" }).into_bytes();
        for p in [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
            p.iter().for_each(|x| out.extend(if little { x.to_le_bytes() } else { x.to_be_bytes() }));
            out.extend([10, 20, 30]);
        }
        out.push(3);
        (0..3i32).for_each(|i| out.extend(if little { i.to_le_bytes() } else { i.to_be_bytes() }));
        out
    };
    hammer("obj", &[obj.into()], 2000, |b| sound(b, "a.obj", false));
    hammer("off", &[off.into()], 1200, |b| sound(b, "a.off", false));
    hammer("stl", &[words.into(), stl], 1600, |b| sound(b, "a.stl", false));
    hammer("stl with repair", &[words.into()], 400, |b| sound(b, "a.stl", true));
    hammer("ply", &[ascii.into(), binary(true), binary(false)], 1800, |b| sound(b, "a.ply", false));
}

#[test]
fn mutated_textures_never_panic_or_hang_and_never_spoil_the_model() {
    if !in_a_small_child("mutated_textures_never_panic_or_hang_and_never_spoil_the_model", 60) {
        return;
    }
    use image::ColorType::{L8, L16, Rgb8, Rgb16, Rgba8};
    let decoded = |bytes: Vec<u8>, mime: &str| {
        let model = wearing(&bytes, mime);
        let asset = io::read_bytes(model, Path::new("a.glb"), &ReadOptions::default()).unwrap();
        assert!(asset.looks[0].texture.is_some() != asset.warnings.iter().any(|w| w.contains("texture left out")));
        asset.looks[0].texture.is_some()
    };
    let png: Vec<Vec<u8>> = [L8, L16, Rgb8, Rgb16, Rgba8].into_iter().map(picture).collect();
    hammer("png", &png, 1000, |b| decoded(b, "image/png"));
    hammer_with("png with right check sums", &png, 1500, |b, r| summed(mutated(b, r)), |b| decoded(b, "image/png"));
    let (mut jpeg, mut webp) = (Vec::new(), Vec::new());
    let small = image::RgbImage::from_fn(24, 16, |x, y| image::Rgb([(9 * x) as u8, (15 * y) as u8, 80]));
    small.write_with_encoder(image::codecs::jpeg::JpegEncoder::new(&mut jpeg)).unwrap();
    small.write_with_encoder(image::codecs::webp::WebPEncoder::new_lossless(&mut webp)).unwrap();
    hammer("jpeg", &[jpeg], 600, |b| decoded(b, "image/jpeg"));
    hammer("webp", &[webp], 600, |b| decoded(b, "image/webp"));
}

#[test]
fn mutated_rigs_cameras_and_archives_never_panic_or_hang() {
    if !in_a_small_child("mutated_rigs_cameras_and_archives_never_panic_or_hang", 60) {
        return;
    }
    let rig = "joints a 0 0 0\njoints b 0 1 0\nroot a\nskin 0 a 0.5 b 0.5\nskin 1 b 1.0\nhier a b\n";
    hammer("rig.txt", &[rig.into()], 2000, |b| io::rig_txt::parse(&b).is_ok());
    let camera = io::camera_json::to_json(&animimic_scene::CameraFile {
        main: animimic_scene::Camera::orbit(glam::DVec3::ZERO, 3.0, 0.3, 0.1, 0.6, 512, 512),
        fps: 24.0,
        views: Vec::new(),
        target: None,
    });
    hammer("camera.json", &[camera.into()], 1000, |b| io::camera_json::parse(&b).is_ok());
    let array = |n: usize| io::npz::Array { shape: vec![n, 2], values: io::npz::Values::F32(vec![0.5; 2 * n]) };
    let archive = io::npz::Archive { arrays: vec![("a".into(), array(10)), ("b".into(), array(1000))] };
    let npz = [io::npz::to_bytes(&archive).unwrap()];
    let read = |b: Vec<u8>| match io::npz::parse(&b) {
        Ok(archive) => {
            archive.arrays.iter().for_each(|(_, a)| assert!(a.to_f64().len() <= a.shape.iter().product()));
            true
        }
        Err(e) => {
            assert!(matches!(e, SceneError::Invalid { .. } | SceneError::Limit { .. }), "{e}");
            false
        }
    };
    hammer("npz", &npz, 1000, read);
    hammer_with("npz by its arrays", &npz, 2000, |b, r| repack::repacked(b, r), read);
}

/// A PNG whose chunks' check sums are right again, as far as its chunks can be followed.
fn summed(mut png: Vec<u8>) -> Vec<u8> {
    let mut at = 8;
    while let Some(head) = png.get(at..at + 4) {
        let end = at + 8 + u32::from_be_bytes(head.try_into().unwrap()) as usize;
        if end + 4 > png.len() {
            break;
        }
        let sum = png[at + 4..end].iter().fold(!0u32, |c, &b| {
            (0..8).fold(c ^ u32::from(b), |c, _| if c & 1 == 1 { 0xEDB8_8320 ^ (c >> 1) } else { c >> 1 })
        });
        png[end..end + 4].copy_from_slice(&(!sum).to_be_bytes());
        at = end + 4;
    }
    png
}

/// What once failed: the change to the fixture, and whether the file is sound in spite of it.
#[test]
fn findings_of_longer_searches_stay_found() {
    type Change = fn(&mut serde_json::Value);
    let findings: [(&str, bool, Change); 5] = [
        ("a scene that is a number", false, |j| j["scenes"] = json!([3])),
        ("nodes of a scene that are no list", false, |j| j["scenes"][0]["nodes"] = json!(2)),
        ("children that are text", false, |j| j["nodes"][3]["children"] = json!("4")),
        ("an image in no buffer and a sampler that is none", false, |j| {
            j["samplers"][0]["wrapS"] = json!(-1);
            let view = j["images"][0]["bufferView"].as_u64().unwrap() as usize;
            j["bufferViews"][view].as_object_mut().unwrap().shift_remove("buffer");
        }),
        // Its skinned mesh was written to a scene that did not show it.
        ("a scene that lists a child", true, |j| {
            j["nodes"][0]["children"] = json!([1]);
            j["nodes"][2]["children"] = json!([0]);
        }),
    ];
    for (name, accepted, change) in findings {
        let mut document = rich();
        change(&mut document.json);
        assert_eq!(sound(document.glb(), "a.glb", false), accepted, "{name}");
    }
}

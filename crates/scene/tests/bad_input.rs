//! What is thrown at the readers: each case a typed one-sentence error within a second, never a panic.
#![allow(clippy::unwrap_used)]

mod common;

use animimic_scene::Asset;
use animimic_scene::io::{self, ReadOptions, SceneError};
use serde_json::{Value, json};
use std::path::Path;
use std::time::{Duration, Instant};

fn read(bytes: Vec<u8>, name: &str, repair: bool) -> Result<Asset, SceneError> {
    let start = Instant::now();
    let result = io::read_bytes(bytes, Path::new(name), &ReadOptions { repair });
    assert!(start.elapsed() < Duration::from_secs(1), "{name} took {:?}", start.elapsed());
    result
}

/// The message of a file that must be refused: one line that names the file and holds `part`.
fn refused(bytes: Vec<u8>, part: &str) -> String {
    let message = read(bytes, "bad.glb", false).map(|_| ()).expect_err(part).to_string();
    println!("{message}");
    assert!(message.starts_with("bad.glb"), "{message}");
    assert!(message.contains(part), "{message:?} does not say {part:?}");
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

/// The fixture with something changed in its JSON.
fn changed(change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let mut document = common::creature();
    change(&mut document.json);
    document.glb()
}

#[test]
fn the_fixture_itself_reads_without_warnings() {
    let asset = read(common::creature().glb(), "good.glb", false).unwrap();
    assert_eq!(asset.warnings, Vec::<String>::new());
    assert_eq!((asset.mesh.positions.len(), asset.mesh.welded_count, asset.mesh.triangles.len()), (11, 9, 5));
}

#[test]
fn files_that_are_no_models_are_named_for_what_they_are() {
    refused(Vec::new(), "empty");
    refused(b"garbage".to_vec(), "not JSON");
    refused(b"<!DOCTYPE html><html></html>".to_vec(), "HTML page");
    refused(b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n".to_vec(), "Git-LFS pointer");
    assert!(read(b"x".to_vec(), "model.xyz", false).unwrap_err().to_string().contains("not a model format"));
    let missing = io::read("no_such_file.glb").unwrap_err();
    assert!(matches!(missing, SceneError::Io { .. }), "{missing}");
}

#[test]
fn truncated_files_say_where_they_end() {
    let whole = common::creature().glb();
    let message = refused(whole[..whole.len() - 10].to_vec(), "truncated");
    assert!(message.contains(&format!("ends at byte {} of {}", whole.len() - 10, whole.len())), "{message}");
    refused(whole[..9].to_vec(), "ends at byte 9");
    let mut chunk = whole.clone();
    chunk[12..16].copy_from_slice(&[0xff; 4]);
    refused(chunk, "a chunk claims 4294967295 bytes");
    for n in 0..whole.len() {
        assert!(read(whole[..n].to_vec(), "cut.glb", false).is_err(), "cut at {n}");
    }
}

#[test]
fn accessors_that_do_not_fit_are_refused_with_their_pointer_before_any_allocation() {
    for count in [9, 1_000_000, 2_000_000_000, u64::MAX / 2] {
        refused(changed(|j| j["accessors"][0]["count"] = json!(count)), "/accessors/0");
    }
    refused(changed(|j| j["bufferViews"][0]["byteLength"] = json!(1_000_000)), "/bufferViews/0");
    refused(changed(|j| j["bufferViews"][0]["byteOffset"] = json!(u64::MAX)), "/bufferViews/0");
    refused(changed(|j| j["bufferViews"][0]["byteStride"] = json!(0)), "byteStride");
    refused(changed(|j| j["accessors"][0]["bufferView"] = json!(99)), "refers to bufferViews 99");
    refused(
        changed(|j| j["accessors"][0] = json!({ "componentType": 5126, "type": "VEC3", "count": 2_000_000_000u32 })),
        "without data",
    );
    refused(changed(|j| j["accessors"][0]["count"] = json!(-3)), "non-negative");
    refused(
        changed(|j| {
            j["accessors"][0]["sparse"] = json!({ "count": 1_000_000_000,
        "indices": { "bufferView": 0, "componentType": 5123 }, "values": { "bufferView": 0 } })
        }),
        "do not fit",
    );
    refused(changed(|j| j["buffers"] = json!([{ "byteLength": 4_000_000_000u32 }])), "/buffers/0");
}

#[test]
fn cycles_and_second_parents_are_refused_and_deep_chains_are_walked() {
    refused(changed(|j| j["nodes"][4]["children"] = json!([2])), "already has the parent");
    refused(
        changed(|j| {
            j["nodes"][0]["children"] = json!([1]);
            j["nodes"][4]["children"] = json!([2]);
        }),
        "cycle",
    );
    refused(changed(|j| j["nodes"][4]["children"] = json!([77])), "refers to nodes 77");
    let deep = changed(|j| {
        let nodes = j["nodes"].as_array_mut().unwrap();
        for i in 0..30_000 {
            nodes.push(json!({ "children": [6 + i] }));
        }
        nodes.push(json!({ "mesh": 1 }));
        j["scenes"][0]["nodes"] = json!([0, 5]);
    });
    let asset = read(deep, "deep.glb", false).unwrap();
    assert_eq!(asset.rig.skeleton.joints.len(), 30_000 + 5);
}

/// The fixture with one value of its binary chunk changed.
fn poked(at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut document = common::creature();
    document.bin[at..at + bytes.len()].copy_from_slice(bytes);
    document.glb()
}

fn offset(accessor: usize) -> usize {
    let json = common::creature().json;
    let view = json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
    json["bufferViews"][view]["byteOffset"].as_u64().unwrap() as usize
}

#[test]
fn indices_joints_and_vertices_out_of_bounds_are_refused_or_repaired_with_a_count() {
    let cases = [
        (
            poked(offset(4), &900u16.to_le_bytes()),
            "1 indices are out of range, the first is 900 at 0",
            "dropped 1 triangles",
        ),
        (poked(offset(3) + 1, &[200]), "", ""),
        (poked(offset(3) + 9, &[200]), "joint 200 with weight 0.5 of vertex 2", "dropped"),
        (poked(offset(0), &f32::NAN.to_le_bytes()), "1 vertices are not finite, the first is 0", "dropped 1 vertices"),
        (poked(offset(2), &f32::NAN.to_le_bytes()), "NaN of vertex 0", "dropped"),
    ];
    for (bytes, message, warning) in cases {
        if message.is_empty() {
            // A joint out of range without weight does nothing.
            assert!(read(bytes, "ok.glb", false).is_ok());
            continue;
        }
        refused(bytes.clone(), message);
        let repaired = read(bytes, "bad.glb", true).unwrap();
        println!("{:?}", repaired.warnings);
        assert!(
            repaired.warnings.iter().any(|w| w.starts_with("repaired") && w.contains(warning)),
            "{:?}",
            repaired.warnings
        );
        assert!(repaired.mesh.positions.iter().all(|p| p.is_finite()));
        let written = io::gltf::write_clips(&repaired, &[], &Default::default()).unwrap();
        let again = read(written, "written.glb", false).unwrap();
        assert_eq!((again.mesh.positions, again.mesh.triangles), (repaired.mesh.positions, repaired.mesh.triangles));
    }
}

#[test]
fn skins_without_joints_or_weights_are_ignored_with_a_warning() {
    let empty = read(changed(|j| j["skins"][0]["joints"] = json!([])), "a.glb", false).unwrap();
    assert!(empty.warnings[0].contains("no joints"), "{:?}", empty.warnings);
    let mut document = common::creature();
    let weights = offset(2);
    document.bin[weights..weights + 128].fill(0);
    let unweighted = read(document.glb(), "b.glb", false).unwrap();
    assert!(unweighted.warnings[0].contains("no weights"), "{:?}", unweighted.warnings);
    let one = read(poked(weights, &0f32.to_le_bytes()), "c.glb", false).unwrap();
    assert!(one.warnings[0].contains("nearest"), "{:?}", one.warnings);
    let two = read(poked(weights, &2f32.to_le_bytes()), "d.glb", false).unwrap();
    assert!(two.warnings[0].contains("normalised"), "{:?}", two.warnings);
    assert_eq!(two.rig.skin.influences[0].iter().map(|i| i.weight).sum::<f64>(), 1.0);
}

#[test]
fn impossible_extents_are_refused_and_degenerate_scales_are_baked() {
    refused(changed(|j| j["nodes"][0]["translation"] = json!([1e39, 0, 0])), "/nodes/0/translation/0");
    refused(changed(|j| j["nodes"][0]["translation"] = json!([3e38, 3e38, 3e38])), "bounding box");
    refused(changed(|j| j["nodes"][0]["scale"] = json!([0, 0, 0])), "bounding box");
    refused(changed(|j| j["scenes"][0]["nodes"] = json!([])), "no triangles");
    refused(
        changed(|j| j["scenes"][0]["nodes"] = json!([9])),
        "/scenes/0/nodes/0: refers to nodes 9, but the file has 5",
    );
    let flat = read(changed(|j| j["nodes"][0]["scale"] = json!([1, 0, 1])), "flat.glb", false).unwrap();
    assert!(flat.mesh.diagonal() > 0.0);
    let front = read(changed(|j| j["nodes"][4]["scale"] = json!([1, 1, 1])), "front.glb", false).unwrap();
    let mirrored = read(changed(|j| j["nodes"][4]["scale"] = json!([-1, 1, 1])), "mirrored.glb", false).unwrap();
    assert_eq!(front.mesh.triangles[4], [8, 9, 10]);
    assert_eq!(mirrored.mesh.triangles[4], [8, 10, 9]);
}

#[test]
fn unknown_required_extensions_are_refused_when_they_may_touch_geometry() {
    refused(changed(|j| j["extensionsRequired"] = json!(["VENDOR_geometry"])), "VENDOR_geometry");
    refused(changed(|j| j["extensionsRequired"] = json!(["KHR_draco_mesh_compression"])), "gltf-transform");
    assert!(read(changed(|j| j["extensionsRequired"] = json!(["KHR_materials_unlit"])), "a.glb", false).is_ok());
    refused(changed(|j| j["asset"]["version"] = json!("1.0")), "1.0");
}

#[test]
fn a_picture_of_enormous_size_is_not_decoded_but_its_bytes_pass_through() {
    let mut document = common::creature();
    // A PNG header that claims 40000 × 40000 pixels.
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    let mut header = [40_000u32.to_be_bytes(), 40_000u32.to_be_bytes()].concat();
    header.extend([8, 6, 0, 0, 0]);
    png.extend(&header);
    png.extend(crc(&[b"IHDR".as_slice(), &header].concat()).to_be_bytes());
    png.extend(b"\0\0\0\x02IDAT\x78\x9c");
    png.extend(crc(b"IDAT\x78\x9c").to_be_bytes());
    let accessor = document.accessor(&png, json!({}));
    let view = document.json["accessors"].as_array_mut().unwrap().remove(accessor)["bufferView"].clone();
    document.json["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    document.json["textures"] = json!([{ "source": 0 }]);
    document.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    let asset = read(document.glb(), "huge.glb", false).unwrap();
    assert!(asset.warnings[0].contains("40000×40000"), "{:?}", asset.warnings);
    assert!(asset.looks[0].texture.is_none());
    let written = io::gltf::write_clips(&asset, &[], &Default::default()).unwrap();
    assert!(written.windows(png.len()).any(|w| w == png));
}

/// CRC-32 of PNG.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |c, &b| {
        (0..8).fold(c ^ u32::from(b), |c, _| if c & 1 == 1 { 0xEDB8_8320 ^ (c >> 1) } else { c >> 1 })
    })
}

//! What is thrown at the program in place of a model, line by line; each through every verb that reads one.
//!
//! | thrown | test |
//! |---|---|
//! | empty, garbage, truncated, HTML, Git-LFS pointer, chunk of ffffffff bytes | `what_is_no_model_or_a_part_of_one…` |
//! | accessor counts and buffer views that do not fit | `counts_and_views_that_do_not_fit…` |
//! | cyclic nodes, 30 000-deep chain | `cycles_are_refused_and_a_chain_of_30_000…` |
//! | index or joint out of range, NaN, bounding box empty or not finite; `--repair` | `numbers_out_of_range…`, `repair_says…` |
//! | skin with zero joints, zero weights, weights that are not normalised | `a_skin_that_holds_nothing…` |
//! | zero-area faces, negative or zero scale, 1e39 translation | `flat_faces_stay…`, `numbers_out_of_range…` |
//! | PNG of 40000×40000 in 194 kB | `a_picture_of_40000_by_40000…` |
//! | unknown required extension | `numbers_out_of_range…` |
//!
//! The readers alone are tested more closely in the crate `scene`, `tests/bad_input.rs`.
#![allow(clippy::unwrap_used)]

#[path = "../../../crates/scene/tests/common/mod.rs"]
mod common;
mod support;

use common::{Document, creature};
use serde_json::{Value, json};
use support::{Bench, example, text};

/// Every verb refuses the file with one sentence.
fn refused(bench: &Bench, name: &str, bytes: &[u8], words: &str) {
    let model = bench.put(name, bytes);
    let (camera, video) = (example("camera.json"), example("creature.mp4"));
    let out = |end: &str| bench.out(end);
    for arguments in [
        vec!["animate", &model, &video, "--camera", &camera, "-o", &out("folder"), "-q"],
        vec!["fit", &model, &video, "--camera", &camera, "-o", &out("clip.glb"), "-q"],
        vec!["rig", &model, "-o", &out("rigged.glb"), "-q"],
        vec!["soften", &model, "-o", &out("soft"), "-q"],
        vec!["tet", &model, "-o", &out("cage.vtu"), "-q"],
        vec!["still", &model, "-o", &out("still.png"), "-q"],
        vec!["render", &model, "-o", &out("look.png"), "-q"],
        vec!["evaluate", &model, &video, "--camera", &camera, "-q"],
    ] {
        bench.refuses(&arguments, &[name, words]);
    }
}

/// The small fixture with something changed in its JSON.
fn changed(change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let mut document = creature();
    change(&mut document.json);
    document.glb()
}

/// Where an accessor of the small fixture starts in its binary chunk.
fn offset(accessor: usize) -> usize {
    let json = creature().json;
    let view = json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
    json["bufferViews"][view]["byteOffset"].as_u64().unwrap() as usize
}

/// The small fixture with bytes changed in its binary chunk.
fn poked(at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut document = creature();
    document.bin[at..at + bytes.len()].copy_from_slice(bytes);
    document.glb()
}

/// JSON and binary chunk of a GLB.
fn split(glb: &[u8]) -> Document {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let mut json: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    json["buffers"] = json!([{}]);
    Document { json, bin: glb[28 + length..].to_vec() }
}

/// The shipped example, a body of 8694 vertices with 25 joints.
fn shipped() -> Document {
    split(&std::fs::read(example("creature.glb")).unwrap())
}

#[test]
fn what_is_no_model_or_a_part_of_one_is_named_for_what_it_is() {
    let bench = Bench::new();
    let whole = creature().glb();
    let mut chunk = whole.clone();
    chunk[12..16].copy_from_slice(&[0xff; 4]);
    let cut = whole.len() - 10;
    refused(&bench, "empty.glb", b"", "empty");
    refused(&bench, "garbage.glb", b"\x07certainly no model", "not JSON");
    refused(&bench, "cut.glb", &whole[..cut], &format!("ends at byte {cut} of {}", whole.len()));
    refused(&bench, "page.glb", b"<!DOCTYPE html><html></html>", "HTML page");
    refused(
        &bench,
        "pointer.glb",
        b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
        "this is a Git-LFS pointer",
    );
    refused(&bench, "chunk.glb", &chunk, "a chunk claims 4294967295 bytes");
}

#[test]
fn counts_and_views_that_do_not_fit_are_refused_with_their_json_pointer() {
    let bench = Bench::new();
    for count in [9u64, 2_000_000_000] {
        refused(&bench, "count.glb", &changed(|j| j["accessors"][0]["count"] = json!(count)), "/accessors/0");
    }
    refused(&bench, "view.glb", &changed(|j| j["bufferViews"][0]["byteLength"] = json!(1_000_000)), "/bufferViews/0");
    let dataless = json!({ "componentType": 5126, "type": "VEC3", "count": 2_000_000_000u32 });
    refused(&bench, "dataless.glb", &changed(|j| j["accessors"][0] = dataless), "/accessors/0");
}

#[test]
fn cycles_are_refused_and_a_chain_of_30_000_nodes_is_walked() {
    let bench = Bench::new();
    let cycle = |j: &mut Value| {
        j["nodes"][0]["children"] = json!([1]);
        j["nodes"][4]["children"] = json!([2]);
    };
    refused(&bench, "cycle.glb", &changed(cycle), "cycle");
    // A chain below the root joint, with a part at its end: every node of it is a joint.
    let mut deep = shipped();
    let nodes = deep.json["nodes"].as_array_mut().unwrap();
    let first = nodes.len();
    nodes.extend((0..30_000).map(|i| json!({ "children": [first + i + 1] })));
    nodes.push(json!({ "mesh": 0 }));
    nodes[1]["children"].as_array_mut().unwrap().push(json!(first));
    let joints = format!("{} joints", deep.json["nodes"].as_array().unwrap().len() - 1);
    let model = bench.put("deep.glb", &deep.glb());
    for command in ["animate", "fit"] {
        let out = bench.out(if command == "fit" { "clip.glb" } else { "folder" });
        bench.refuses(
            &[command, &model, &example("creature.mp4"), "--camera", &example("camera.json"), "-o", &out, "-q"],
            &["deep.glb", &joints],
        );
    }
    bench.does(&["render", &model, "-o", &bench.out("deep.png"), "--height", "96"], &[]);
    bench.does(&["still", &model, "-o", &bench.out("still.png"), "--size", "96x96"], &[]);
}

#[test]
fn numbers_out_of_range_are_refused_with_their_count_and_the_first_place() {
    let bench = Bench::new();
    let nan = f32::NAN.to_le_bytes();
    refused(
        &bench,
        "index.glb",
        &poked(offset(4), &900u16.to_le_bytes()),
        "1 indices are out of range, the first is 900 at 0",
    );
    refused(&bench, "joint.glb", &poked(offset(3) + 9, &[200]), "1 influences are unusable, the first is joint 200");
    refused(&bench, "nan.glb", &poked(offset(0) + 12, &nan), "1 vertices are not finite, the first is 1");
    refused(&bench, "weight.glb", &poked(offset(2), &nan), "NaN of vertex 0");
    let moved = |x: f64| changed(|j| j["nodes"][0]["translation"] = json!([x, x, x]));
    refused(&bench, "far.glb", &moved(3e38), "bounding box");
    refused(&bench, "farther.glb", &moved(1e39), "/nodes/0/translation/0");
    refused(&bench, "point.glb", &changed(|j| j["nodes"][0]["scale"] = json!([0, 0, 0])), "bounding box");
    refused(
        &bench,
        "vendor.glb",
        &changed(|j| j["extensionsRequired"] = json!(["VENDOR_geometry"])),
        "VENDOR_geometry",
    );
}

#[test]
fn repair_says_how_many_it_dropped_and_the_result_is_sound() {
    let bench = Bench::new();
    let nan = f32::NAN.to_le_bytes();
    let whole = shipped();
    let accessor = |name: &str| whole.json["meshes"][0]["primitives"][0]["attributes"][name].as_u64().unwrap() as usize;
    let start = |accessor: usize| {
        let view = whole.json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
        whole.json["bufferViews"][view]["byteOffset"].as_u64().unwrap_or(0) as usize
    };
    let indices = start(whole.json["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize);
    let (positions, joints) = (start(accessor("POSITION")), start(accessor("JOINTS_0")));
    let cases: [(&str, usize, &[u8], &str); 3] = [
        ("index", indices, &[0xff, 0xff, 0xff, 0xff], "repaired: dropped 1 triangles"),
        ("vertex", positions + 4, &nan, "repaired: dropped 1 vertices"),
        ("joint", joints, &[250], "repaired: dropped 1 unusable influences"),
    ];
    for (name, at, bytes, words) in cases {
        let mut document = shipped();
        document.bin[at..at + bytes.len()].copy_from_slice(bytes);
        let model = bench.put(&format!("{name}.glb"), &document.glb());
        let out = bench.out(&format!("{name}.glb"));
        assert_eq!(support::limited(&["rig", &model, "-o", &out, "-q"], None).status.code(), Some(1));
        bench.does(&["rig", &model, "-o", &out, "--repair", "--detail", "1"], &[words]);
        // What was written needs no repair.
        bench.does(&["render", &out, "-o", &bench.out("look.png"), "--height", "64"], &[]);
        bench.does(&["render", &model, "--repair", "-o", &bench.out("look.png"), "--height", "64"], &[words]);
        let said = bench.does(&["tet", &model, "--repair", "--tets", "500", "-o", &bench.out("cage.vtu")], &[]);
        assert!(text(&said.stdout).contains(words), "{}", text(&said.stdout));
        let said = bench.does(&["still", &model, "--repair", "--size", "64x64", "-o", &bench.out("still.png")], &[]);
        assert!(text(&said.stdout).contains(words), "{}", text(&said.stdout));
    }
    let (camera, video, model) = (example("camera.json"), example("creature.mp4"), bench.path("joint.glb"));
    let out = bench.out("clip.glb");
    let short = ["--camera", &camera, "-o", &out, "--frames", "0..2", "--height", "64"];
    bench.does(
        &[&["fit", &model, &video, "--repair"][..], &short].concat(),
        &["repaired: dropped 1 unusable influences"],
    );
}

#[test]
fn a_skin_that_holds_nothing_is_replaced_and_a_careless_one_is_mended() {
    let bench = Bench::new();
    let (camera, video) = (example("camera.json"), example("creature.mp4"));
    let mut jointless = shipped();
    jointless.json["skins"][0]["joints"] = json!([]);
    let model = bench.put("jointless.glb", &jointless.glb());
    let out = bench.out("jointless.glb");
    bench.does(
        &["fit", &model, &video, "--camera", &camera, "-o", &out, "--frames", "0..2", "--height", "64"],
        &["/skins/0 has no joints", "joints was made (geometric)"],
    );
    let weights = offset(2);
    let mut unweighted = creature();
    unweighted.bin[weights..weights + 128].fill(0);
    for (name, bytes, words) in [
        ("unweighted.glb", unweighted.glb(), "no weights; the part is rigid"),
        ("one.glb", poked(weights, &0f32.to_le_bytes()), "moves with its nearest"),
        ("two.glb", poked(weights, &2f32.to_le_bytes()), "do not sum to 1; normalised"),
    ] {
        let model = bench.put(name, &bytes);
        bench.does(&["render", &model, "-o", &bench.out("look.png"), "--height", "64"], &[words]);
    }
}

#[test]
fn flat_faces_stay_in_the_output_and_out_of_the_physics_and_mirrors_are_turned() {
    let bench = Bench::new();
    // Every tenth triangle of the example loses its area.
    let mut document = shipped();
    let accessor = document.json["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize;
    let count = document.json["accessors"][accessor]["count"].clone();
    let width = if document.json["accessors"][accessor]["componentType"] == 5123 { 2 } else { 4 };
    let view = document.json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
    let start = document.json["bufferViews"][view]["byteOffset"].as_u64().unwrap_or(0) as usize;
    for triangle in (0..count.as_u64().unwrap() as usize / 3).step_by(10) {
        let at = start + 3 * width * triangle;
        document.bin.copy_within(at..at + width, at + width);
    }
    let model = bench.put("flat.glb", &document.glb());
    bench.does(&["tet", &model, "--tets", "500", "-o", &bench.out("cage.vtu")], &[]);
    bench.does(&["rig", &model, "--detail", "1", "-o", &bench.out("rigged.glb")], &[]);
    let written = split(&std::fs::read(bench.out("rigged.glb")).unwrap());
    let accessor = written.json["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize;
    assert_eq!(written.json["accessors"][accessor]["count"], count);
    // A mirrored model is drawn as its mirror image: the same picture from the other side, turned over.
    let look = |name: &str, scale: f64, view: &str| {
        let mut mirrored = shipped();
        let roots = mirrored.json["scenes"][0]["nodes"].clone();
        let nodes = mirrored.json["nodes"].as_array_mut().unwrap();
        nodes.push(json!({ "children": roots, "scale": [scale, 1, 1] }));
        mirrored.json["scenes"][0]["nodes"] = json!([mirrored.json["nodes"].as_array().unwrap().len() - 1]);
        let model = bench.put(name, &mirrored.glb());
        let out = bench.out("look.png");
        bench.does(
            &["render", &model, "-o", &out, "--views", view, "--height", "96", "--camera", "preset:puppeteer"],
            &[],
        );
        let mut reader =
            png::Decoder::new(std::io::BufReader::new(std::fs::File::open(out).unwrap())).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        pixels.as_chunks::<3>().0.to_vec()
    };
    let (plain, mirrored) = (look("plain.glb", 1.0, "+40"), look("mirrored.glb", -1.0, "-40"));
    let turned: Vec<[u8; 3]> = (0..96 * 96).map(|i| mirrored[i / 96 * 96 + 95 - i % 96]).collect();
    let apart = |a: &[[u8; 3]], b: &[[u8; 3]]| {
        a.iter().zip(b).filter(|(p, q)| (0..3).any(|c| p[c].abs_diff(q[c]) > 40)).count() as f64 / a.len() as f64
    };
    println!("{:.4} of the pixels differ, unturned {:.4}", apart(&plain, &turned), apart(&plain, &mirrored));
    assert!(apart(&plain, &turned) < 0.01 && apart(&plain, &mirrored) > 0.1);
}

/// A PNG of one bit a pixel, all black: 200 MB of pixels in a quarter of a megabyte.
fn bomb(side: u32) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, side, side);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::One);
    encoder.set_compression(png::Compression::High);
    let mut writer = encoder.write_header().unwrap();
    let mut stream = writer.stream_writer().unwrap();
    let rows = vec![0u8; side as usize / 8 * 400];
    for _ in 0..side / 400 {
        std::io::Write::write_all(&mut stream, &rows).unwrap();
    }
    stream.finish().unwrap();
    drop(writer);
    out
}

#[test]
fn a_picture_of_40000_by_40000_is_not_decoded_but_its_bytes_pass_through() {
    let bench = Bench::new();
    let png = bomb(40_000);
    println!("{} bytes", png.len());
    let mut document = shipped();
    let accessor = document.accessor(&png, json!({}));
    let view = document.json["accessors"].as_array_mut().unwrap().remove(accessor)["bufferView"].clone();
    document.json["images"][0] = json!({ "bufferView": view, "mimeType": "image/png" });
    let model = bench.put("bomb.glb", &document.glb());
    let out = bench.out("look.png");
    bench.does(&["render", &model, "-o", &out, "--height", "64"], &["40000×40000"]);
    bench.does(&["rig", &model, "--detail", "1", "-o", &bench.out("rigged.glb")], &["40000×40000"]);
    let written = std::fs::read(bench.out("rigged.glb")).unwrap();
    assert!(written.windows(png.len()).any(|w| w == png));
    // The same picture where a frame, a mask or a camera should be.
    let folder = bench.path("frames");
    std::fs::create_dir(&folder).unwrap();
    for k in 0..2 {
        std::fs::write(format!("{folder}/{k}.png"), &png).unwrap();
    }
    let fresh = Bench::new();
    fresh.refuses(&["cues", &folder, "-o", &fresh.out("cues"), "-q"], &["frames"]);
    let video = example("creature.mp4");
    let (camera, model) = (example("camera.json"), example("creature.glb"));
    let job = ["animate", &model, &video, "-o", &fresh.out("folder"), "-q"];
    let short = ["--frames", "0..2", "--height", "64"];
    fresh.refuses(&[&job[..], &short, &["--camera", &camera, "--mask", &folder]].concat(), &["0.png"]);
    fresh.refuses(&[&job[..], &short, &["--camera", &format!("{folder}/0.png")]].concat(), &["0.png"]);
}

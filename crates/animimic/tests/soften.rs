//! `soften` from file to files.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use animimic::Physics;
use animimic::scene::io::{self, gltf};
use animimic::soften::{Soften, soften};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

fn model() -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/models/greenman.glb"));
    if !path.exists() {
        println!("skipped: {} is absent", path.display());
    }
    path.exists().then(|| path.to_owned())
}

fn job(name: &str) -> Option<Soften> {
    let out = std::env::temp_dir().join(format!("animimic_soften_{name}_{}", std::process::id()));
    Some(Soften { tets: 600, fps: 12.0, height_px: 64, ..Soften::new(model()?, out) })
}

#[test]
fn a_clip_gains_soft_tissue_and_stays_in_the_rig() {
    let Some(mut job) = job("rig") else { return };
    job.softness = vec!["jelly".parse().unwrap()];
    job.clip = Some("2_move".into());
    let report = soften(&job, &mut |_| ControlFlow::Continue(())).unwrap();
    let rms = |key: &str| report["export"][key]["rms"].as_f64().unwrap();
    assert!(rms("residual_percent") < 0.25 * rms("skinned_percent"), "helper bones carry most of it");
    assert!(report["from_skinning_rms_percent"].as_f64().unwrap() > 0.1, "jelly sways");
    println!("{report:#}");
    let number = |key: &str| report[key].as_f64().unwrap();
    assert_eq!(number("inverted_tets"), 0.0);
    assert!(number("volume_change") < 0.05);
    assert!(number("self_intersections") <= number("self_intersections_skinned"));
    let (before, after) = (io::read(&job.model).unwrap(), io::read(job.out.join("softened.glb")).unwrap());
    assert!(gltf::clips(&after).unwrap().iter().any(|c| c.name == "2_move"), "the clip keeps its name");
    assert_eq!(before.mesh.positions.len(), after.mesh.positions.len());
    assert!(job.out.join("views.mp4").metadata().unwrap().len() > 1000 && job.out.join("report.json").exists());
    std::fs::remove_dir_all(&job.out).unwrap();
}

/// The model with `_SOFTNESS` painted on every vertex of every skinned mesh.
fn painted(model: &Path, name: &str, softness: f32) -> PathBuf {
    let bytes = std::fs::read(model).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let mut json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let mut bin = bytes[28 + length..].to_vec();
    for m in 0..json["meshes"].as_array().unwrap().len() {
        for p in 0..json["meshes"][m]["primitives"].as_array().unwrap().len() {
            let position = json["meshes"][m]["primitives"][p]["attributes"]["POSITION"].as_u64().unwrap() as usize;
            let count = json["accessors"][position]["count"].as_u64().unwrap() as usize;
            bin.resize(bin.len().next_multiple_of(4), 0);
            let view = serde_json::json!({"buffer": 0, "byteOffset": bin.len(), "byteLength": 4 * count});
            (0..count).for_each(|_| bin.extend(softness.to_le_bytes()));
            let views = json["bufferViews"].as_array_mut().unwrap();
            views.push(view);
            let view = views.len() - 1;
            let accessors = json["accessors"].as_array_mut().unwrap();
            accessors
                .push(serde_json::json!({"bufferView": view, "componentType": 5126, "count": count, "type": "SCALAR"}));
            let accessor = accessors.len() - 1;
            json["meshes"][m]["primitives"][p]["attributes"]["_SOFTNESS"] = accessor.into();
        }
    }
    json["buffers"][0]["byteLength"] = bin.len().into();
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut out = b"glTF".to_vec();
    out.extend([2, (28 + text.len() + bin.len()) as u32, text.len() as u32].iter().flat_map(|n| n.to_le_bytes()));
    out.extend_from_slice(b"JSON");
    out.extend(text);
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend_from_slice(b"BIN\0");
    out.extend(bin);
    let path = std::env::temp_dir().join(format!("animimic_painted_{name}_{}.glb", std::process::id()));
    std::fs::write(&path, out).unwrap();
    path
}

#[test]
fn painted_softness_says_how_far_flesh_leaves_the_skin() {
    let Some(mut job) = job("painted") else { return };
    job.clip = Some("2_move".into());
    let swayed = |paint: Option<f32>| {
        let model = paint.map_or(job.model.clone(), |s| painted(&job.model, &s.to_string(), s));
        let job = Soften { model, softness: vec!["jelly".parse().unwrap()], physics: Physics::NONE, ..job.clone() };
        let report = soften(&job, &mut |_| ControlFlow::Continue(())).unwrap();
        if paint.is_some() {
            std::fs::remove_file(&job.model).unwrap();
        }
        report["from_skinning_rms_percent"].as_f64().unwrap()
    };
    let (bare, none, half, all) = (swayed(None), swayed(Some(0.0)), swayed(Some(0.5)), swayed(Some(1.0)));
    println!("unpainted {bare:.4} %, painted 0: {none:.1e} %, 0.5: {half:.4} %, 1: {all:.4} %");
    assert!(bare > 0.1 && none < 1e-5 && (half / bare - 0.5).abs() < 0.05 && (all / bare - 1.0).abs() < 1e-9);
    std::fs::remove_dir_all(&job.out).unwrap();
}

#[test]
fn wrong_wishes_are_refused_before_anything_is_written() {
    let Some(good) = job("wrong") else { return };
    let words = |job: &Soften| soften(job, &mut |_| ControlFlow::Continue(())).unwrap_err().to_string();
    for (job, expected) in [
        (Soften { loose: vec!["elbow".into()], ..good.clone() }, "no joint named elbow"),
        (Soften { softness: vec!["Hair=jelly".parse().unwrap()], ..good.clone() }, "no material named Hair"),
        (Soften { clip: Some("fly".into()), ..good.clone() }, "no clip named fly"),
        (Soften { tets: 0, ..good.clone() }, "tets"),
        (Soften { size_m: -1.0, ..good.clone() }, "diagonal"),
        (Soften { fps: 0.0, ..good.clone() }, "frames per second"),
        (Soften { physics: Physics::default(), out: good.model.clone(), ..good.clone() }, "is a file"),
    ] {
        let error = words(&job);
        println!("{error}");
        assert!(error.contains(expected), "{error}");
        assert!(!good.out.exists(), "{expected}: something was written");
    }
}

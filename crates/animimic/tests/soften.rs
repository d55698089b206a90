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
    println!("{report:#}");
    let number = |key: &str| report[key].as_f64().unwrap();
    assert_eq!(number("inverted_tets"), 0.0);
    assert!(number("volume_change") < 0.05);
    assert!(number("self_intersections") <= number("self_intersections_skinned"));
    assert!(number("from_skinning_rms_percent") > 0.1, "jelly sways");
    let rms = |key: &str| report["export"][key]["rms"].as_f64().unwrap();
    assert!(rms("residual_percent") < 0.5 * rms("skinned_percent"), "helper bones carry most of it");
    let (before, after) = (io::read(&job.model).unwrap(), io::read(job.out.join("softened.glb")).unwrap());
    assert!(gltf::clips(&after).unwrap().iter().any(|c| c.name == "2_move"), "the clip keeps its name");
    assert_eq!(before.mesh.positions.len(), after.mesh.positions.len());
    assert!(job.out.join("views.mp4").metadata().unwrap().len() > 1000 && job.out.join("report.json").exists());
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

//! `animimic cues`: cues of other programs in, any form out.
#![allow(clippy::unwrap_used)]

mod support;

use animimic::scene::io::npz;
use serde_json::Value;
use std::path::Path;
use support::{Bench, example, limited, text};

fn cues(arguments: &[&str]) -> Value {
    let video = example("creature.mp4");
    let out = limited(&[&["cues", &video], arguments, &["--height", "96", "--json", "-q"]].concat(), None);
    assert!(out.status.success(), "{}", text(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

#[cfg(not(feature = "neural"))]
#[test]
fn a_build_without_networks_says_how_to_get_one_with_them() {
    let bench = Bench::new();
    let (video, net) = (example("creature.mp4"), bench.put("u2netp.onnx", b"any"));
    let run = |arguments: &[&str]| {
        let out = limited(&[&["cues", &video, "-o", &bench.out("x"), "-q"], arguments].concat(), None);
        (out.status.code(), text(&out.stderr))
    };
    let (code, said) = run(&["--mask", &format!("onnx:{net}")]);
    println!("{said}");
    assert!(code == Some(1) && said.contains("u2netp.onnx") && said.contains("--features neural"));
    let (code, said) = run(&["--depth", &format!("onnx:{net}:u2net")]);
    println!("{said}");
    assert!(code == Some(2) && said.contains("there are midas, depth-anything"));
    assert!(bench.results().is_empty());
}

#[test]
fn cues_go_from_form_to_form_and_come_back_the_same() {
    let bench = Bench::new();
    let (first, pictures, again) = (bench.out("first"), bench.out("pictures"), bench.out("again"));
    let found = cues(&["-o", &first]);
    let inside = |folder: &str, name: &str| Path::new(folder).join(name).display().to_string();
    let (masks, tracks) = (inside(&first, "masks.npz"), inside(&first, "tracks.npz"));
    let as_pictures = cues(&["-o", &pictures, "--mask", &masks, "--tracks", &tracks, "--form", "png"]);
    assert_eq!(as_pictures["points"], found["points"]);
    let folder = inside(&pictures, "masks");
    assert_eq!(std::fs::read_dir(&folder).unwrap().count() as u64, found["frames"].as_u64().unwrap());
    let back =
        cues(&["-o", &again, "--mask", &folder, "--tracks", &tracks, "--depth", &folder, "--depth-kind", "inverse"]);
    assert_eq!((&back["depth_maps"], &back["points"]), (&found["frames"], &found["points"]));
    let same =
        |name: &str| std::fs::read(inside(&first, name)).unwrap() == std::fs::read(inside(&again, name)).unwrap();
    assert!(same("masks.npz"));
    // Pixels go to the working size and back: the last bits are rounding.
    let pixels = |folder: &str| npz::read(inside(folder, "tracks.npz")).unwrap().get("tracks").unwrap().to_f64();
    let apart = pixels(&first).iter().zip(pixels(&again)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    println!("tracks come back within {apart:.1e} px");
    assert!(apart < 1e-3);
    assert!(Path::new(&inside(&again, "depth.npz")).is_file() && Path::new(&inside(&again, "overlay.mp4")).is_file());
    // Cues of another video are refused.
    let fresh = Bench::new();
    let short = fresh.path("short");
    std::fs::create_dir(&short).unwrap();
    for k in 0..3 {
        std::fs::copy(Path::new(&folder).join(format!("{k:05}.png")), Path::new(&short).join(format!("{k}.png")))
            .unwrap();
    }
    let video = example("creature.mp4");
    let out = limited(&["cues", &video, "--mask", &short, "-o", &fresh.out("x"), "--height", "64", "-q"], None);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("3 masks for a video of 49 frames"), "{}", text(&out.stderr));
    assert!(fresh.results().is_empty());
}

//! Rigs made from shape alone, on the models of the shared data.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use animimic::metrics::skeleton_distance::{Bones, distances};
use animimic::rigging::{DEFAULT_RIGGER, RigJob, RigReport, make, rig_files};
use animimic::scene::{Asset, Rig, io};
use animimic_rig::riggers::{self, RigOptions};
use glam::DVec3;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

fn data() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    if !folder.is_dir() {
        println!("skipped: no shared data beside the repository");
        return None;
    }
    Some(folder)
}

fn rigged(path: &Path) -> (Asset, Rig) {
    let asset = io::read(path).unwrap();
    let rig = make(&asset, DEFAULT_RIGGER, &RigOptions::default()).unwrap();
    (asset, rig)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
}

/// Shares of vertices that joints of both sides move, at least one of them not the first of its limb.
fn crossing(rig: &Rig) -> f64 {
    let name = |slot: u32| rig.skeleton.joints[rig.skin.slots[slot as usize].joint].name.as_str();
    let of = |slot: u32, side: &str| name(slot).split('_').any(|w| w == side);
    let crossed = rig.skin.influences.iter().filter(|list| {
        let strong = || list.iter().filter(|i| i.weight > 0.02).map(|i| i.slot);
        let first = |slot: u32| name(slot).ends_with("_01");
        strong().any(|a| of(a, "L") && strong().any(|b| of(b, "R") && !(first(a) && first(b))))
    });
    crossed.count() as f64 / rig.skin.influences.len() as f64
}

#[test]
fn rigs_are_as_near_to_the_artists_as_asked_and_no_limb_moves_another_across_a_gap() {
    let Some(data) = data() else { return };
    let mut all: Vec<[f64; 3]> = Vec::new();
    let cases = [
        "cesium_man_walk",
        "cow_eating",
        "fox_run",
        "fox_survey",
        "greenman_move",
        "knight_cheer",
        "koi_swim",
        "rat_walk",
        "robot_dance",
        "trex_attack",
        "wolf_gallop",
    ];
    for case in cases {
        let folder = data.join("gt").join(case);
        let artist = io::read(folder.join("static.glb")).unwrap();
        let (asset, rig) = rigged(&folder.join("static_norig.glb"));
        let (lo, hi) = asset.mesh.bounds();
        let d = distances(&Bones::new(&rig), &Bones::new(&artist.rig), (hi - lo).max_element());
        let crossed = crossing(&rig);
        println!("{case:16} J2J {:.2} J2B {:.2} B2B {:.2}, crossing {crossed:.4}", d[0], d[1], d[2]);
        assert!(crossed < 0.01, "{case}: {crossed} of the vertices follow limbs of both sides");
        all.push(d);
    }
    let [j2j, j2b, b2b] = [0, 1, 2].map(|k| median(all.iter().map(|d| d[k]).collect()));
    println!("medians: J2J {j2j:.2}, J2B {j2b:.2}, B2B {b2b:.2}");
    assert!(j2j <= 6.0 && j2b <= 4.5 && b2b <= 4.0);
}

#[test]
fn every_still_model_clean_or_dirty_is_rigged_and_symmetric_ones_come_out_symmetric() {
    let Some(data) = data() else { return };
    let models = [
        "c3d_spot.obj",
        "c3d_suzanne.obj",
        "igl_bunny.off",
        "igl_cow.off",
        "igl_elephant.obj",
        "igl_lion.off",
        "tm_busted.STL",
        "tm_chair_model.obj",
        "tm_rabbit.obj",
        "tm_soup.stl",
        "tm_tube.obj",
        "tm_wallhole.obj",
        "mesh2motion/model-bird.glb",
        "mesh2motion/model-dragon.glb",
        "mesh2motion/model-kaiju.glb",
        "mesh2motion/model-shark.glb",
        "mesh2motion/model-spider.glb",
    ];
    let mut symmetric = 0;
    for model in models {
        let (asset, rig) = rigged(&data.join("static").join(model));
        let joints = &rig.skeleton.joints;
        assert!((1..=80).contains(&joints.len()), "{model}: {} joints", joints.len());
        for list in &rig.skin.influences {
            let sum: f64 = list.iter().map(|i| i.weight).sum();
            assert!(sum == 1.0 && list.len() <= 4 && list.iter().all(|i| i.weight >= 0.0), "{model}: {list:?}");
        }
        let worst = asymmetry(&rig, asset.mesh.bounds());
        println!("{model:28} {:3} joints, pairs apart by {worst:?}", joints.len());
        if ["spot", "suzanne", "bird", "dragon", "kaiju", "shark", "spider"].iter().any(|m| model.contains(m)) {
            assert!(worst.is_some_and(|w| w < 0.01), "{model}: {worst:?}");
            symmetric += 1;
        }
    }
    assert_eq!(symmetric, 7);
}

/// Largest distance of a left joint's image from its right partner [longest side]; the plane is that of the pairs themselves, x = const.
fn asymmetry(rig: &Rig, (lo, hi): (DVec3, DVec3)) -> Option<f64> {
    let world = rig.skeleton.rest_world();
    let names: Vec<&str> = rig.skeleton.joints.iter().map(|j| j.name.as_str()).collect();
    let pairs: Vec<(DVec3, DVec3)> = (0..names.len())
        .filter(|&j| names[j].contains("_L_"))
        .filter_map(|j| {
            let twin = names.iter().position(|n| *n == names[j].replace("_L_", "_R_"))?;
            Some((world[j].translation, world[twin].translation))
        })
        .collect();
    let middle = pairs.iter().map(|(a, b)| a.x + b.x).sum::<f64>() / pairs.len().max(1) as f64;
    let off = |&(a, b): &(DVec3, DVec3)| DVec3::new(middle - a.x, a.y, a.z).distance(b);
    pairs.iter().map(off).max_by(f64::total_cmp).map(|d| d / (hi - lo).max_element())
}

#[test]
fn a_rig_txt_that_was_written_is_read_back_identically_and_by_an_independent_reader() {
    let Some(data) = data() else { return };
    let folder = tempfile::tempdir().unwrap();
    // An OBJ with texture seams: rig.txt counts its v lines, not the vertices that seams split.
    let model = folder.path().join("spot.obj");
    std::fs::copy(data.join("static/c3d_spot.obj"), &model).unwrap();
    let out = folder.path().join("rig.txt");
    let job = RigJob {
        model: model.clone(),
        out: out.clone(),
        rigger: DEFAULT_RIGGER.into(),
        detail: 3,
        file: None,
        picture: None,
        repair: false,
    };
    let report: RigReport = rig_files(&job, &mut |_| ControlFlow::Continue(())).unwrap();
    let (asset, rig) = {
        let bare = folder.path().join("bare");
        std::fs::create_dir(&bare).unwrap();
        std::fs::copy(&model, bare.join("spot.obj")).unwrap();
        rigged(&bare.join("spot.obj"))
    };
    let back = io::read(&model).unwrap();
    assert_eq!(back.rig.skeleton.joints.len(), report.joints.len());
    let sorted = |list: &[animimic::scene::Influence]| {
        let mut l: Vec<(String, u64)> =
            list.iter().map(|i| (rig.skeleton.joints[i.slot as usize].name.clone(), i.weight.to_bits())).collect();
        l.sort();
        l
    };
    let name = |j: usize| back.rig.skeleton.joints[back.rig.skin.slots[j].joint].name.clone();
    for (v, list) in back.rig.skin.influences.iter().enumerate() {
        let mut theirs: Vec<(String, u64)> = list.iter().map(|i| (name(i.slot as usize), i.weight.to_bits())).collect();
        theirs.sort();
        assert_eq!(theirs, sorted(&rig.skin.influences[v]), "vertex {v} of {}", asset.mesh.positions.len());
    }
    read_as_rignet_does(&std::fs::read_to_string(&out).unwrap(), &report.joints);
}

/// The published format in a few lines: words by spaces, four kinds of lines, every v line skinned, a tree from one root.
fn read_as_rignet_does(text: &str, names: &[String]) {
    let (mut joints, mut parents, mut root, mut skinned) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for line in text.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        match words[0] {
            "joints" => {
                assert!(words[2..].iter().all(|w| w.parse::<f64>().unwrap().is_finite()) && words.len() == 5);
                joints.push(words[1]);
            }
            "root" => root.push(words[1]),
            "hier" => parents.push((words[1], words[2])),
            "skin" => {
                assert_eq!(words[1].parse::<usize>().unwrap(), skinned.len());
                let pairs: Vec<(&str, f64)> = words[2..].chunks(2).map(|p| (p[0], p[1].parse().unwrap())).collect();
                assert!(pairs.iter().all(|p| joints.contains(&p.0)));
                skinned.push(pairs.iter().map(|p| p.1).sum::<f64>());
            }
            other => panic!("{other:?} is no line of the format"),
        }
    }
    println!("{} joints, {} vertices", joints.len(), skinned.len());
    assert!(joints.iter().all(|j| names.iter().any(|n| n == j)) && joints.len() == names.len());
    assert_eq!((root.len(), parents.len()), (1, joints.len() - 1));
    assert!(skinned.iter().all(|s| (s - 1.0).abs() < 1e-6) && skinned.len() == 2930);
}

#[test]
fn a_rigged_glb_stands_where_the_model_stood_and_bends() {
    let Some(data) = data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let model = data.join("gt/fox_survey/static_norig.glb");
    let out = folder.path().join("fox.glb");
    let job = RigJob {
        model: model.clone(),
        out: out.clone(),
        rigger: "geometric".into(),
        detail: 2,
        file: None,
        picture: None,
        repair: false,
    };
    let report = rig_files(&job, &mut |_| ControlFlow::Continue(())).unwrap();
    let (before, after) = (io::read(&model).unwrap(), io::read(&out).unwrap());
    assert!(after.rig.is_articulated() && after.rig.skeleton.joints.len() >= report.joints.len());
    let off = before.mesh.positions.iter().zip(&after.mesh.positions).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    println!("{} joints, rest off by {:.1e} of the diagonal", report.joints.len(), off / before.mesh.diagonal());
    assert!(off < 1e-5 * before.mesh.diagonal());
    // The same rig again, taken from that file.
    let options = RigOptions { file: Some(out), ..RigOptions::default() };
    let taken = riggers::rigger("from-file").unwrap().rig(&before, &options).unwrap();
    assert_eq!(taken.skin.influences.len(), before.mesh.positions.len());
    assert!(taken.skeleton.joints.iter().any(|j| j.name == "head"));
}

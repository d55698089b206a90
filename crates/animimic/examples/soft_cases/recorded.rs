//! The joints' true motion of a case of the test data, as a clip of its still model.

use animimic::scene::io::{self, npz};
use animimic::scene::{Asset, Motion};
use glam::{DQuat, DVec3};
use std::path::{Path, PathBuf};

/// The folder of the cases, where it is there.
pub fn cases() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/gt"));
    folder.is_dir().then(|| folder.to_owned())
}

/// Names of all cases, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a readable folder").flatten();
    let mut names: Vec<String> = entries
        .filter(|e| e.path().join("static.glb").exists())
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// The still model of a case and its joints' true motion.
pub fn recorded(case: &Path) -> (Asset, Motion) {
    let asset = io::read(case.join("static.glb")).expect("a readable model");
    let truth = npz::read(case.join("gt.npz")).expect("a readable truth");
    let nodes = truth.need("joint_node").expect("joint_node").to_f64();
    let trs = truth.need("joint_local_trs").expect("joint_local_trs").to_f64();
    let fps = io::camera_json::read(case.join("camera.json")).expect("a camera").fps;
    let joint_of = |node: f64| asset.rig.skeleton.joints.iter().position(|j| j.node == Some(node as usize));
    let columns: Vec<Option<usize>> = nodes.iter().map(|n| joint_of(*n)).collect();
    let pose = |frame: &[f64]| {
        let mut locals = asset.rig.skeleton.rest_locals();
        for (t, joint) in frame.chunks_exact(10).zip(&columns) {
            let Some(j) = *joint else { continue };
            locals[j].translation = DVec3::new(t[0], t[1], t[2]);
            locals[j].rotation = DQuat::from_xyzw(t[3], t[4], t[5], t[6]).normalize();
            locals[j].scale = DVec3::new(t[7], t[8], t[9]);
        }
        animimic::scene::Pose { locals }
    };
    let poses = trs.chunks_exact(10 * nodes.len()).map(pose).collect();
    let motion = Motion { name: "truth".into(), fps, poses };
    (asset, motion)
}

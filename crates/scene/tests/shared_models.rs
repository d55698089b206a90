//! Every model of the shared data reads, and stands where its bytes say.
#![allow(clippy::unwrap_used)]

use animimic_scene::io;
use std::path::{Path, PathBuf};

fn shared() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    if path.is_dir() {
        return Some(path);
    }
    println!("skipped: no shared data at {}", path.display());
    None
}

fn files(root: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    let (mut found, mut folders) = (Vec::new(), vec![root.to_path_buf()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| extensions.contains(&&*e.to_string_lossy().to_lowercase())) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

#[test]
fn every_shared_model_reads_with_positive_extent_and_complete_influences() {
    let Some(root) = shared() else { return };
    let paths = files(&root, &["glb", "gltf", "obj", "off", "stl"]);
    assert!(paths.len() > 40, "{}", paths.len());
    for path in paths {
        let asset = match io::read(&path) {
            Ok(asset) => asset,
            Err(e) if e.to_string().contains("gltf-transform") => {
                println!("{e}");
                continue;
            }
            Err(e) => panic!("{e}"),
        };
        let mesh = &asset.mesh;
        println!(
            "{}: {} vertices ({} welded), {} triangles, {} joints, {} slots, diagonal {:.3}, {} looks ({} textured), {:?}",
            path.strip_prefix(&root).unwrap().display(),
            mesh.positions.len(),
            mesh.welded_count,
            mesh.triangles.len(),
            asset.rig.skeleton.joints.len(),
            asset.rig.skin.slots.len(),
            mesh.diagonal(),
            asset.looks.len(),
            asset.looks.iter().filter(|l| l.texture.is_some()).count(),
            asset.warnings
        );
        assert_eq!(asset.rig.skin.influences.len(), mesh.positions.len());
        for list in &asset.rig.skin.influences {
            let sum: f64 = list.iter().map(|i| i.weight).sum();
            assert!((sum - 1.0).abs() < 1e-12, "weights sum to {sum}");
        }
    }
}

#[test]
fn puppeteer_folders_read_with_their_rigs() {
    let Some(root) = shared() else { return };
    for (name, welded, joints) in [("fish", 838, 29), ("crocodile", 1966, 28)] {
        let folder = root.join("real").join(name);
        let asset = io::read(&folder).unwrap();
        println!(
            "{name}: {} welded of {} vertices, {:?}",
            asset.mesh.welded_count,
            asset.mesh.positions.len(),
            asset.warnings
        );
        assert_eq!(asset.mesh.welded_count, welded);
        assert!(asset.rig.skeleton.joints.len() == joints && asset.rig.is_articulated());
        assert!(io::puppeteer::input_video(&folder).is_some());
        let world = asset.rig.skeleton.rest_world();
        let worst = asset
            .rig
            .skinned(&world)
            .iter()
            .zip(&asset.mesh.positions)
            .map(|(a, b)| a.distance(*b))
            .fold(0.0, f64::max);
        assert!(worst < 1e-12 * asset.mesh.diagonal().max(1.0), "rest pose is off by {worst}");
    }
}

#[test]
fn camera_files_and_archives_of_every_case_read() {
    let Some(root) = shared() else { return };
    for path in files(&root.join("gt"), &["json", "npz"]) {
        if path.ends_with("camera.json") {
            let file = io::camera_json::read(&path).unwrap();
            assert_eq!((file.views.len(), file.main.width), (2, 512));
        } else if path.ends_with("gt.npz") {
            let archive = io::npz::read(&path).unwrap();
            let shape = &archive.need("verts_unique").unwrap().shape;
            println!("{}: {shape:?}", path.display());
            assert_eq!(shape[2], 3);
        }
    }
}

#[test]
fn our_kinematics_follow_the_recorded_truth_of_every_case() {
    // The truth's first frame was recorded by three.js from the pose that static.glb stands in, and is rounded to 2⁻¹⁸ of the diagonal.
    let Some(root) = shared() else { return };
    let mut compared = 0;
    for path in files(&root.join("gt"), &["glb"]) {
        let archive = io::npz::read(path.with_file_name("gt.npz")).unwrap();
        let unique = archive.need("verts_unique").unwrap();
        let index = archive.need("vert_to_unique").unwrap().to_f64();
        let first: Vec<f64> = unique.to_f64().into_iter().take(unique.shape[1] * 3).collect();
        let asset = io::read(&path).unwrap();
        assert_eq!(asset.mesh.positions.len(), index.len());
        let worst = asset
            .mesh
            .positions
            .iter()
            .zip(&index)
            .map(|(p, &i)| p.distance(glam::DVec3::from_slice(&first[3 * i as usize..][..3])))
            .fold(0.0, f64::max)
            / asset.mesh.diagonal();
        println!("{}: {worst:.2e} of the diagonal", path.display());
        assert!(worst < 1e-5, "{}: {worst}", path.display());
        compared += 1;
    }
    assert!(compared >= 28, "{compared}");
}

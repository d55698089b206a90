//! Every model of the shared data reads, and stands where its bytes say.

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
fn every_shared_gltf_model_reads_with_positive_extent_and_complete_influences() {
    let Some(root) = shared() else { return };
    let paths = files(&root, &["glb", "gltf"]);
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

//! Which models there are: shared with the test of cages.

use std::path::{Path, PathBuf};

/// Models in a folder and its folders, sorted.
pub fn models(folder: &Path, out: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder).map(|dir| dir.filter_map(|e| e.ok().map(|e| e.path())).collect()).unwrap_or_default();
    entries.sort();
    for path in entries {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if path.is_dir() {
            models(&path, out);
        } else if ["glb", "gltf", "obj", "off", "stl", "ply"].contains(&extension.as_str()) {
            out.push(path);
        }
    }
}

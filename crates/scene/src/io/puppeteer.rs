//! A Puppeteer input folder as it stands: `objs/mesh.obj`, `objs/rig.txt`, materials and texture, `input.mp4`.

use super::{Format, ReadOptions, SceneError, load, obj::Obj};
use crate::Asset;
use std::path::{Path, PathBuf};

/// The model of a folder.
///
/// # Errors
/// [`SceneError::Unsupported`] if the folder has no `objs/mesh.obj`; else those of the OBJ reader.
pub fn read(folder: &Path, options: &ReadOptions) -> Result<Asset, SceneError> {
    let model = folder.join("objs").join("mesh.obj");
    if !model.is_file() {
        let what = "a folder without objs/mesh.obj (Puppeteer's layout); name the model file itself";
        return Err(SceneError::unsupported(folder.display().to_string(), what));
    }
    Obj.read(load(&model)?, &model, options).map_err(|e| e.in_file(&model))
}

/// The folder's video, if it has one.
pub fn input_video(folder: &Path) -> Option<PathBuf> {
    Some(folder.join("input.mp4")).filter(|p| p.is_file())
}

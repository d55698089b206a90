//! What each stage of a job depends on.

use super::Job;
use crate::Error;
use crate::camera::CameraChoice;
use crate::run::Key;
use animimic_scene::{Asset, Video};
use std::path::PathBuf;

/// The model as it was read and rigged, and whether the rig is of our making.
pub fn model(asset: &Asset, made_rig: bool) -> Key {
    Key::new("take").and_asset(asset).and(made_rig)
}

/// What is seen in video number `index`: the model, the video, and what was given with it.
///
/// # Errors
/// A given file that cannot be read.
pub fn seen(job: &Job, index: usize, model: &Key, video: &Video) -> Result<Key, Error> {
    let mut key = model.clone().and("seen").and_video(video);
    for (what, sources) in [("masks", &job.masks), ("depth", &job.depth)] {
        if let Some(source) = sources.get(index) {
            // Where the file lies does not count.
            key = key.and(what).and(source.at(PathBuf::new())).and_path(source.path())?;
        }
    }
    if let Some(path) = job.tracks.get(index) {
        key = key.and("tracks").and_path(path)?;
    }
    key = key.and(job.depth_kind);
    match &job.camera {
        CameraChoice::File(path) => key.and("camera").and_path(path),
        choice => Ok(key.and(choice)),
    }
}

/// The motion that is found in it.
pub fn motion(job: &Job, name: &str, seen: &Key) -> Key {
    seen.clone().and("motion").and((name, job.preset, job.seed))
}

/// The soft tissue of all takes.
pub fn soft(job: &Job, motions: &[Key]) -> Key {
    motions.iter().fold(Key::new("soft").and(&job.flesh), |key, m| key.and(m))
}

/// All files of the job.
pub fn whole(job: &Job, motions: &[Key]) -> Key {
    let model = job.model.file_name().map(PathBuf::from);
    motions.iter().fold(Key::new("whole").and(model).and(job.words()), |key, m| key.and(m))
}

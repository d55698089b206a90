//! Files: one module per format, and the door through which all of them are read.
//!
//! A new format is one file with a type that implements [`Format`], and one word in `FORMATS`.

pub mod atomic;
pub mod camera_json;
pub mod error;
pub mod gltf;
mod mtl;
pub mod npz;
pub mod obj;
pub mod off;
pub mod orphans;
mod picture;
mod plain;
pub mod ply;
mod polygon;
pub mod puppeteer;
pub mod rig_txt;
pub mod stl;
pub mod tets;
mod text;
pub mod trajectory;
pub mod weld;

pub use atomic::{sweep, write_atomically};
pub use error::SceneError;

use crate::Asset;
use std::path::Path;

/// Largest file that is read whole [bytes].
const MAX_FILE_BYTES: u64 = 1 << 30;

/// How to read.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Mend what can be mended (out-of-range indices and joints, NaN vertices) and say how much, instead of refusing.
    pub repair: bool,
}

/// One readable file format.
pub trait Format: Sync {
    /// Name on the command line and in `animimic list formats`.
    fn name(&self) -> &'static str;
    /// File name extensions, lower case, without the dot.
    fn extensions(&self) -> &'static [&'static str];
    /// One line on what is read from it.
    fn summary(&self) -> &'static str;
    /// Reads the file's bytes; `path` serves to find the files it refers to.
    ///
    /// # Errors
    /// Any [`SceneError`], without the file's name: the door adds it.
    fn read(&self, bytes: Vec<u8>, path: &Path, options: &ReadOptions) -> Result<Asset, SceneError>;
    /// Whether the first bytes are surely of this format, whatever the file's name.
    fn recognises(&self, _bytes: &[u8]) -> bool {
        false
    }
}

/// All formats, in the order of `animimic list formats`.
const FORMATS: &[&dyn Format] = &[&gltf::Gltf, &obj::Obj, &off::Off, &stl::Stl, &ply::Ply];

/// All readable formats.
pub fn formats() -> &'static [&'static dyn Format] {
    FORMATS
}

/// Reads a model with the default options.
///
/// # Errors
/// See [`read_with`].
pub fn read(path: impl AsRef<Path>) -> Result<Asset, SceneError> {
    read_with(path, &ReadOptions::default())
}

/// Reads a model; the format is taken from the content where it tells, else from the file name's extension.
///
/// # Errors
/// [`SceneError`] with the file's name, the place in it, and what is wrong there.
pub fn read_with(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Asset, SceneError> {
    let path = path.as_ref();
    if path.is_dir() {
        return puppeteer::read(path, options);
    }
    let bytes = load(path)?;
    read_bytes(bytes, path, options)
}

/// Reads a model from bytes already in memory; `path` gives the extension and the folder of files referred to.
///
/// # Errors
/// See [`read_with`].
pub fn read_bytes(bytes: Vec<u8>, path: &Path, options: &ReadOptions) -> Result<Asset, SceneError> {
    foreign_content(&bytes).map_or(Ok(()), |what| Err(SceneError::invalid(path.display().to_string(), what)))?;
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let format = FORMATS
        .iter()
        .find(|f| f.recognises(&bytes))
        .or_else(|| FORMATS.iter().find(|f| f.extensions().contains(&extension.as_str())))
        .ok_or_else(|| {
            let known: Vec<&str> = FORMATS.iter().flat_map(|f| f.extensions().iter().copied()).collect();
            SceneError::unsupported(
                path.display().to_string(),
                format!("not a model format that is read here ({}); convert it to GLB", known.join(", ")),
            )
        })?;
    format.read(bytes, path, options).map_err(|e| e.in_file(path))
}

/// Refuses meshes without triangles, without extent, or without finite extent.
pub(crate) fn check_extent(mesh: &crate::Mesh) -> Result<(), SceneError> {
    if mesh.triangles.is_empty() {
        return Err(SceneError::invalid("", "the model has no triangles"));
    }
    if let Some(v) = mesh.positions.iter().position(|p| !p.is_finite()) {
        return Err(SceneError::invalid("", format!("vertex {v} is not finite where the model is displayed")));
    }
    let diagonal = mesh.diagonal();
    if diagonal > 0.0 && diagonal.is_finite() && diagonal < f64::from(f32::MAX) {
        return Ok(());
    }
    Err(SceneError::invalid("", format!("the bounding box is empty or not finite (diagonal {diagonal:e})")))
}

/// The whole file, if it is a file of bearable size.
pub(crate) fn load(path: &Path) -> Result<Vec<u8>, SceneError> {
    let meta = std::fs::metadata(path).map_err(|e| SceneError::io(path, "open it", e))?;
    if !meta.is_file() {
        return Err(SceneError::invalid(path.display().to_string(), "not a regular file"));
    }
    if meta.len() > MAX_FILE_BYTES {
        let what = format!("{} bytes, more than the {MAX_FILE_BYTES} that are read", meta.len());
        return Err(SceneError::limit(path.display().to_string(), what));
    }
    std::fs::read(path).map_err(|e| SceneError::io(path, "read it", e))
}

/// What stands in the place of a model when a download or checkout went wrong.
fn foreign_content(bytes: &[u8]) -> Option<String> {
    let start = bytes.iter().position(|b| !b.is_ascii_whitespace())?;
    let head: Vec<u8> = bytes[start..].iter().take(64).map(u8::to_ascii_lowercase).collect();
    if head.starts_with(b"version https://git-lfs") {
        return Some("this is a Git-LFS pointer, not the file itself; run `git lfs pull`".into());
    }
    if head.starts_with(b"<!doctype html") || head.starts_with(b"<html") {
        return Some("this is an HTML page, not a model; download the file itself".into());
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_has_its_own_name_and_extensions_and_refuses_empty_and_foreign_bytes() {
        let mut seen: Vec<&str> = Vec::new();
        for format in formats() {
            for word in format.extensions() {
                assert!(!seen.contains(word), "{word} belongs to two formats");
                seen.push(word);
                let path = format!("a.{word}");
                for bytes in [&b""[..], b"\0\0\0\0", b"<!doctype html>", b"12 34 garbage \xff\xfe"] {
                    let result = read_bytes(bytes.to_vec(), Path::new(&path), &ReadOptions::default());
                    let message = result.map(|_| ()).expect_err(word).to_string();
                    assert!(message.starts_with(&path) && message.lines().count() == 1, "{message}");
                }
            }
            assert!(!format.summary().is_empty() && format.name().chars().all(|c| c.is_ascii_lowercase()));
        }
    }
}

//! Cue files, ours and those of other programs: masks, tracks and depth as npz, masks and depth as folders of PNGs, depth as EXRs.

mod depth;
mod exr;
mod masks;
mod tracks;

pub use depth::{read_depth, write_depth};
pub use masks::{packed_bits, read_masks, write_masks};
pub use tracks::{read_tracks, write_tracks};

use crate::error::{Result, VideoError};
use animimic_scene::io::npz::{Archive, Array, Values, read as read_npz, write as write_npz};
use std::path::{Path, PathBuf};

/// Longest axis of an array without values.
const LONGEST_EMPTY: usize = 1 << 16;

fn opened(path: &Path) -> Result<Archive> {
    read_npz(path).map_err(|e| VideoError::invalid(path, e.to_string()))
}

fn saved(path: &Path, arrays: Vec<(&str, Vec<usize>, Values)>) -> Result<()> {
    let arrays = arrays.into_iter().map(|(name, shape, values)| (name.to_string(), Array { shape, values })).collect();
    write_npz(path, &Archive { arrays }).map_err(|e| VideoError::invalid(path, e.to_string()))
}

/// Numbers of an archive, with their name and shape in it.
struct Named<'a> {
    name: &'a str,
    shape: &'a [usize],
    values: Vec<f32>,
}

impl Named<'_> {
    /// The shape without axes of length 1 beyond what `axes` need: a batch in front, a channel at the end.
    fn squeezed(&self, axes: usize) -> Vec<usize> {
        let mut shape = self.shape.to_vec();
        while shape.len() > axes && shape[0] == 1 {
            shape.remove(0);
        }
        while shape.len() > axes && shape.last() == Some(&1) {
            shape.pop();
        }
        shape
    }
}

/// The array of that name, if it is there and holds numbers.
fn maybe<'a>(path: &Path, archive: &'a Archive, names: &[&str]) -> Result<Option<Named<'a>>> {
    let found = names.iter().find_map(|n| archive.arrays.iter().find(|(name, _)| name == n));
    let Some((name, array)) = found else { return Ok(None) };
    if let Values::Opaque(kind) = &array.values {
        return Err(VideoError::invalid(
            path,
            format!("{name} holds {kind}, not numbers; save it as an array of numbers"),
        ));
    }
    // Without values the length of an axis is a claim only, and all that is made for it is empty.
    if array.shape.contains(&0) && array.shape.iter().any(|&d| d > LONGEST_EMPTY) {
        return Err(VideoError::invalid(path, format!("{name} of shape {:?} holds nothing", array.shape)));
    }
    Ok(Some(Named { name, shape: &array.shape, values: array.to_f32() }))
}

/// The array of the first name that is there.
fn any<'a>(path: &Path, archive: &'a Archive, names: &[&str]) -> Result<Named<'a>> {
    maybe(path, archive, names)?.ok_or_else(|| {
        let found: Vec<&str> = archive.arrays.iter().map(|(n, _)| n.as_str()).collect();
        let what = format!("none of the arrays {} is there, only {}", names.join(", "), found.join(", "));
        VideoError::invalid(path, what)
    })
}

/// The pictures of a folder with that ending, in order of their names; none is an error.
fn pictures(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    let files = files_ending(folder, ending)?;
    let none = || VideoError::invalid(folder, format!("the folder holds no {} pictures", ending.to_uppercase()));
    if files.is_empty() { Err(none()) } else { Ok(files) }
}

fn files_ending(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(VideoError::io(folder))? {
        let file = entry.map_err(VideoError::io(folder))?.path();
        if file.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)) {
            files.push(file);
        }
    }
    crate::source::folder::sort_naturally(&mut files);
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_scene::DepthKind;

    #[test]
    fn wrong_shapes_names_and_kinds_are_refused_with_what_is_there() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("odd.npz");
        saved(&path, vec![("tracks", vec![2, 3], Values::F32(vec![0.0; 6]))]).expect("writes");
        assert!(read_tracks(&path, None).expect_err("refused").to_string().contains("[2, 3]"));
        assert!(read_masks(&path).expect_err("refused").to_string().contains("only tracks"));
        assert!(read_depth(&folder.path().join("absent.npz"), None).is_err());
        saved(&path, vec![("depth", vec![6], Values::F32(vec![0.0; 6]))]).expect("writes");
        assert!(read_depth(&path, Some(DepthKind::Metric)).expect_err("refused").to_string().contains("[6]"));
        let text = Archive {
            arrays: vec![("masks".into(), Array { shape: vec![1, 2, 2], values: Values::Opaque("<U4".into()) })],
        };
        assert!(any(&path, &text, &["masks"]).is_err_and(|e| e.to_string().contains("holds <U4, not numbers")));
    }
}

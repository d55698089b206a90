//! Tetrahedral meshes as files for other programs. Written only.
//!
//! A new format is one file with a type that implements [`TetFormat`], and one word in `TET_FORMATS`.

mod arrays;
mod msh;
mod vtu;

use super::{SceneError, write_atomically};
use crate::{Embedding, TetMesh};
use std::io::Write;
use std::path::Path;

/// One writable file format.
pub trait TetFormat: Sync {
    /// File name extension, lower case, without the dot.
    fn extension(&self) -> &'static str;
    /// The file's bytes.
    ///
    /// # Errors
    /// [`SceneError::Caller`] for a mesh that cannot be written.
    fn bytes(&self, mesh: &TetMesh, embedding: &Embedding) -> Result<Vec<u8>, SceneError>;
}

/// All formats.
pub const TET_FORMATS: &[&dyn TetFormat] = &[&vtu::Vtu, &msh::Msh, &arrays::Arrays];

/// Writes a tet mesh in the format that the file's name says: `.vtu` (ParaView), `.msh` (Gmsh), `.npz` (NumPy; with the embedding).
///
/// # Errors
/// [`SceneError::Caller`] for other names; [`SceneError::Io`].
pub fn write(path: impl AsRef<Path>, mesh: &TetMesh, embedding: &Embedding) -> Result<(), SceneError> {
    let path = path.as_ref();
    let bytes = format(path)?.bytes(mesh, embedding)?;
    write_atomically(path, |w| w.write_all(&bytes))
}

/// The format that a file's name says.
///
/// # Errors
/// [`SceneError::Caller`] for names of no format.
pub fn format(path: &Path) -> Result<&'static dyn TetFormat, SceneError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    TET_FORMATS.iter().copied().find(|f| f.extension() == extension).ok_or_else(|| {
        let names: Vec<String> = TET_FORMATS.iter().map(|f| format!(".{}", f.extension())).collect();
        SceneError::Caller(format!("{}: tets are written as {}; name the file so", path.display(), names.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::npz;
    use glam::DVec3;

    fn one() -> (TetMesh, Embedding) {
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(0.1, 0.2, 1.0 / 3.0)];
        let mesh = TetMesh { positions, tets: vec![[0, 1, 2, 3]] };
        (mesh, Embedding { tet: vec![0], barycentric: vec![[0.25; 4]] })
    }

    #[test]
    fn every_format_writes_every_coordinate_exactly_and_counts_right() {
        let (mesh, embedding) = one();
        let folder = tempfile::tempdir().unwrap();
        for format in TET_FORMATS {
            let path = folder.path().join(format!("a.{}", format.extension()));
            write(&path, &mesh, &embedding).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            if format.extension() == "npz" {
                let file = npz::parse(&bytes).unwrap();
                assert_eq!(file.need("positions").unwrap().to_f64()[11], 1.0 / 3.0);
                assert_eq!(file.need("tets").unwrap().shape, [1, 4]);
                assert_eq!(file.need("surface_barycentric").unwrap().shape, [1, 4]);
                continue;
            }
            let text = String::from_utf8(bytes).unwrap();
            let numbers = text.split(|c: char| c.is_whitespace() || c == '<').filter_map(|w| w.parse::<f64>().ok());
            assert!(numbers.clone().any(|n| n == 1.0 / 3.0), "{} rounds", format.extension());
            assert!(text.contains("0 1 2 3") || text.contains("1 2 3 4"), "{} has no tet", format.extension());
        }
        let refused = write(folder.path().join("a.txt"), &mesh, &embedding).unwrap_err().to_string();
        assert!(refused.contains(".vtu") && !folder.path().join("a.txt").exists());
    }
}

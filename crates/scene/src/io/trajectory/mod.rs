//! Vertices over time as files for other programs. Written only.
//!
//! A new cache format is one file with a type that implements [`CacheFormat`], and one word in `CACHE_FORMATS`.

mod mdd;
mod pc2;
mod usda;
mod wavefront;

use super::{SceneError, write_atomically};
use crate::{Asset, Trajectory};
use std::io::Write;
use std::path::Path;

pub use wavefront::write as write_obj;

/// One writable format of point caches.
pub trait CacheFormat: Sync {
    /// File name extension, lower case, without the dot.
    fn extension(&self) -> &'static str;
    /// Writes the vertices of all frames, in the order of the asset's mesh.
    ///
    /// # Errors
    /// Those of the writer.
    fn write(&self, out: &mut dyn Write, asset: &Asset, trajectory: &Trajectory) -> std::io::Result<()>;
}

/// All formats.
pub const CACHE_FORMATS: &[&dyn CacheFormat] = &[&pc2::Pc2, &mdd::Mdd, &usda::Usda];

/// Writes a cache whole or not at all.
///
/// # Errors
/// [`SceneError::Io`]; [`SceneError::Caller`] for a trajectory of another mesh.
pub fn save(
    format: &dyn CacheFormat,
    path: impl AsRef<Path>,
    asset: &Asset,
    trajectory: &Trajectory,
) -> Result<(), SceneError> {
    let vertices = asset.mesh.positions.len();
    if let Some(f) = trajectory.frames.iter().position(|f| f.len() != vertices) {
        let found = trajectory.frames[f].len();
        return Err(SceneError::Caller(format!("frame {f} has {found} vertices, the mesh has {vertices}")));
    }
    write_atomically(path, |w| format.write(w, asset, trajectory))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Look, Mesh, Part};
    use glam::{DVec2, DVec3};

    fn asset() -> (Asset, Trajectory) {
        let mesh = Mesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
            uvs: vec![DVec2::new(0.0, 0.25); 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            parts: vec![Part { name: "a b".into(), vertices: 0..4, triangles: 0..2, look: 0, skin: None }],
            ..Mesh::default()
        };
        let frames = (0..3).map(|f| mesh.positions.iter().map(|p| *p + DVec3::X * f64::from(f)).collect()).collect();
        let asset = Asset { mesh, looks: vec![Look { name: "skin.1".into(), ..Look::default() }], ..Asset::default() };
        (asset, Trajectory { fps: 24.0, frames })
    }

    fn bytes(format: &dyn CacheFormat) -> Vec<u8> {
        let (asset, trajectory) = asset();
        let mut out = Vec::new();
        format.write(&mut out, &asset, &trajectory).unwrap();
        out
    }

    #[test]
    fn pc2_is_a_header_of_32_bytes_and_little_endian_floats() {
        let b = bytes(&pc2::Pc2);
        assert_eq!(&b[..12], b"POINTCACHE2\0");
        let int = |at: usize| i32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]);
        let float = |at: usize| f32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]);
        assert_eq!((int(12), int(16), float(20), float(24), int(28)), (1, 4, 0.0, 1.0, 3));
        assert_eq!(b.len(), 32 + 3 * 4 * 12);
        // Frame 2, vertex 1, x.
        assert_eq!(float(32 + 2 * 48 + 12), 3.0);
    }

    #[test]
    fn mdd_is_big_endian_with_the_times_before_the_points() {
        let b = bytes(&mdd::Mdd);
        let int = |at: usize| i32::from_be_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]);
        let float = |at: usize| f32::from_be_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]);
        assert_eq!((int(0), int(4), float(12)), (3, 4, 1.0 / 24.0));
        assert_eq!(b.len(), 8 + 12 + 3 * 48);
        assert_eq!(float(20 + 48 + 12), 2.0);
    }

    #[test]
    fn usd_has_a_sample_per_frame_and_flips_v() {
        let text = String::from_utf8(bytes(&usda::Usda)).unwrap();
        println!("{text}");
        assert!(text.starts_with("#usda 1.0"));
        assert!(text.contains("def Mesh \"a_b_0\"") && text.contains("2: [(2, 0, 0), (3, 0, 0)"));
        assert!(text.contains("timeCodesPerSecond = 24") && text.contains("(0, 0.75)"));
    }

    #[test]
    fn an_obj_frame_reads_back_as_the_mesh_in_that_frame() {
        let (asset, trajectory) = asset();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("2.obj");
        write_obj(&path, &asset, &trajectory.frames[2]).unwrap();
        let read = crate::io::read(&path).unwrap();
        assert_eq!(read.mesh.positions, trajectory.frames[2]);
        assert_eq!(read.mesh.triangles, asset.mesh.triangles);
        assert_eq!(read.mesh.uvs, asset.mesh.uvs);
        let short = Trajectory { frames: vec![Vec::new()], ..trajectory };
        assert!(save(&pc2::Pc2, folder.path().join("x.pc2"), &asset, &short).is_err());
        assert!(!folder.path().join("x.pc2").exists());
    }
}

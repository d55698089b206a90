//! STL, binary and ASCII. Corners at the same position become one vertex; the format's facet normals are ignored.

use super::text::{lines, triple};
use super::{Format, ReadOptions, SceneError, plain, weld};
use crate::{Asset, Look, Mesh, Part};
use glam::DVec3;
use std::path::Path;

/// The STL reader.
pub struct Stl;

impl Format for Stl {
    fn name(&self) -> &'static str {
        "stl"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["stl"]
    }

    fn summary(&self) -> &'static str {
        "STL, binary and ASCII"
    }

    fn read(&self, bytes: Vec<u8>, _path: &Path, options: &ReadOptions) -> Result<Asset, SceneError> {
        let corners = if is_binary(&bytes) { binary(&bytes)? } else { ascii(&bytes)? };
        plain::asset(indexed(corners), vec![Look::default()], options, Vec::new())
    }
}

const HEADER: usize = 84;
const FACET: usize = 50;

/// Binary files may start with "solid" too: what tells is the length, or a text without facets.
fn is_binary(bytes: &[u8]) -> bool {
    let claimed = bytes.get(80..HEADER).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let exact = claimed.and_then(|n| n.checked_mul(FACET)).and_then(|n| n.checked_add(HEADER)) == Some(bytes.len());
    exact || !bytes.trim_ascii_start().starts_with(b"solid")
}

fn binary(bytes: &[u8]) -> Result<Vec<DVec3>, SceneError> {
    let count = bytes
        .get(80..HEADER)
        .ok_or_else(|| SceneError::invalid("", format!("ends at byte {} of the {HEADER}-byte header", bytes.len())))?;
    let count = u32::from_le_bytes([count[0], count[1], count[2], count[3]]) as usize;
    let end = count.checked_mul(FACET).and_then(|n| n.checked_add(HEADER)).filter(|&end| end <= bytes.len());
    let Some(end) = end else {
        let what = format!("claims {count} triangles, but ends at byte {}; it is truncated", bytes.len());
        return Err(SceneError::invalid("", what));
    };
    let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let corner = |c: &[u8]| DVec3::new(float(&c[0..4]), float(&c[4..8]), float(&c[8..12]));
    Ok(bytes[HEADER..end]
        .chunks_exact(FACET)
        .flat_map(|f| [corner(&f[12..]), corner(&f[24..]), corner(&f[36..])])
        .collect())
}

fn ascii(bytes: &[u8]) -> Result<Vec<DVec3>, SceneError> {
    let text = lines(bytes);
    let mut corners = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        if words.next() == Some("vertex") {
            corners.push(triple(&mut words, i + 1)?);
        }
    }
    if corners.len() % 3 != 0 {
        return Err(SceneError::invalid(
            "",
            format!("{} corners are not whole triangles; it is truncated", corners.len()),
        ));
    }
    Ok(corners)
}

fn indexed(corners: Vec<DVec3>) -> Mesh {
    let (welded, count) = weld::by_position(&corners);
    let mut positions = vec![DVec3::ZERO; count];
    welded.iter().zip(&corners).for_each(|(&i, &p)| positions[i as usize] = p);
    let triangles: Vec<[u32; 3]> = welded.as_chunks::<3>().0.to_vec();
    let part = Part { name: String::new(), vertices: 0..count, triangles: 0..triangles.len(), look: 0, skin: None };
    Mesh { positions, triangles, parts: vec![part], ..Mesh::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_triangle_reads_from_text_and_from_bytes() {
        let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1.5 0\nendloop\nendfacet\nendsolid a\n";
        let from_text = Stl.read(text.into(), Path::new("a.stl"), &ReadOptions::default()).unwrap();
        let mut bytes = b"solid but binary".to_vec();
        bytes.resize(80, 0);
        bytes.extend(1u32.to_le_bytes());
        bytes.extend(
            [0.0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.5, 0.0].iter().flat_map(|x| x.to_le_bytes()),
        );
        bytes.extend([0, 0]);
        let from_bytes = Stl.read(bytes, Path::new("a.stl"), &ReadOptions::default()).unwrap();
        assert_eq!(from_text.mesh.positions, from_bytes.mesh.positions);
        assert_eq!(from_text.mesh.triangles, [[0, 1, 2]]);
    }
}

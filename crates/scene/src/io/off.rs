//! Object File Format: OFF, COFF (vertex colours), NOFF (normals) and STOFF (texture coordinates).

use super::text::{bad_line, lines, number};
use super::{Format, ReadOptions, SceneError, plain, polygon};
use crate::{Asset, Look, Mesh, Part};
use glam::{DVec2, DVec3};
use std::path::Path;

/// The OFF reader.
pub struct Off;

impl Format for Off {
    fn name(&self) -> &'static str {
        "off"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["off", "coff"]
    }

    fn summary(&self) -> &'static str {
        "Object File Format, with vertex colours (COFF), normals (NOFF), texture coordinates (STOFF)"
    }

    fn read(&self, bytes: Vec<u8>, _path: &Path, options: &ReadOptions) -> Result<Asset, SceneError> {
        plain::asset(parse(&bytes)?, vec![Look::default()], options, Vec::new())
    }
}

/// A line without its comment and its number from 1.
type Line<'a> = (usize, &'a str);

fn parse(bytes: &[u8]) -> Result<Mesh, SceneError> {
    let text = lines(bytes);
    let content = |(i, l): (usize, &'_ str)| (i + 1, l.split('#').next().unwrap_or("").trim().to_string());
    let rows: Vec<(usize, String)> = text.lines().enumerate().map(content).filter(|(_, l)| !l.is_empty()).collect();
    let mut rows = rows.iter().map(|(i, l)| (*i, l.as_str()));
    let (at, first) = rows.next().ok_or_else(|| SceneError::invalid("", "the file is empty"))?;
    let (keyword, rest) = first.split_at(first.find(char::is_whitespace).unwrap_or(first.len()));
    let flags = keyword.strip_suffix("OFF").ok_or_else(|| bad_line(at, format!("{keyword:?} is not an OFF header")))?;
    if flags.contains(['4', 'n']) {
        return Err(SceneError::unsupported(format!("line {at}"), "only three-dimensional OFF is read"));
    }
    let counts = if rest.trim().is_empty() { rows.next() } else { Some((at, rest)) };
    let (at, counts) = counts.ok_or_else(|| bad_line(at, "the counts are missing"))?;
    let mut counts = counts.split_whitespace();
    let mut count = || number(counts.next(), at).map(|n| n as usize);
    let (vertices, faces) = (count()?, count()?);
    // Every vertex and face takes a line, so counts that exceed the lines are caught without allocating for them.
    let mut mesh = Mesh::default();
    let mut need = |what: &str, k: usize, total: usize| -> Result<Line, SceneError> {
        rows.next().ok_or_else(|| SceneError::invalid("", format!("ends at {what} {k} of {total}; it is truncated")))
    };
    for k in 0..vertices {
        let (at, row) = need("vertex", k, vertices)?;
        vertex(&mut mesh, row, at, flags)?;
    }
    for k in 0..faces {
        let (at, row) = need("face", k, faces)?;
        face(&mut mesh, row, at)?;
    }
    mesh.parts = vec![Part {
        name: String::new(),
        vertices: 0..mesh.positions.len(),
        triangles: 0..mesh.triangles.len(),
        look: 0,
        skin: None,
    }];
    Ok(mesh)
}

/// x y z, then by the header's letters: normal (N), colour (C), texture coordinates (ST), in this order.
fn vertex(mesh: &mut Mesh, row: &str, at: usize, flags: &str) -> Result<(), SceneError> {
    let words: Vec<&str> = row.split_whitespace().collect();
    let x: Vec<f64> = words.iter().map(|w| number(Some(w), at)).collect::<Result<_, _>>()?;
    let (has_n, has_c, has_st) = (flags.contains('N'), flags.contains('C'), flags.contains("ST"));
    let fixed = 3 + if has_n { 3 } else { 0 } + if has_st { 2 } else { 0 };
    if x.len() < fixed + if has_c { 3 } else { 0 } {
        return Err(bad_line(at, format!("a vertex of {} numbers", x.len())));
    }
    mesh.positions.push(DVec3::new(x[0], x[1], x[2]));
    let mut next = 3;
    if has_n {
        mesh.normals.push(DVec3::new(x[3], x[4], x[5]).normalize_or_zero());
        next = 6;
    }
    if has_c {
        // Whole numbers are bytes, numbers with a point are in [0, 1].
        let scale = if words[next..next + 3].iter().any(|w| w.contains('.')) { 1.0 } else { 255.0 };
        let linear = |c: f64| crate::image::linear_from_srgb((c / scale).clamp(0.0, 1.0) as f32);
        mesh.colors.push([x[next], x[next + 1], x[next + 2]].map(linear));
    }
    if has_st {
        mesh.uvs.push(DVec2::new(x[x.len() - 2], 1.0 - x[x.len() - 1]));
    }
    Ok(())
}

fn face(mesh: &mut Mesh, row: &str, at: usize) -> Result<(), SceneError> {
    let mut words = row.split_whitespace();
    let n = number(words.next(), at)? as usize;
    let mut corners: Vec<u32> = Vec::new();
    for _ in 0..n {
        let i = number(words.next(), at)?;
        if !(i >= 0.0 && i < mesh.positions.len() as f64) {
            return Err(bad_line(at, format!("vertex {i} of {}", mesh.positions.len())));
        }
        corners.push(i as u32);
    }
    let points: Vec<DVec3> = corners.iter().map(|&i| mesh.positions[i as usize]).collect();
    mesh.triangles.extend(polygon::triangulate(&points).iter().map(|t| t.map(|k| corners[k])));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_and_comments_and_quads_are_read() {
        let text = "COFF # hello\n4 1 0\n0 0 0 255 0 0 255\n1 0 0 255 255 255 255\n1 1 0 0 0 0 255\n0 1 0 0 0 0 255\n4 0 1 2 3 200 0 0\n";
        let mesh = parse(text.as_bytes()).unwrap();
        assert_eq!((mesh.positions.len(), mesh.triangles.len(), mesh.colors[0]), (4, 2, [1.0, 0.0, 0.0]));
    }

    #[test]
    fn lying_counts_and_bad_corners_are_refused() {
        for text in [
            "OFF\n4000000000 1 0\n0 0 0\n",
            "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
            "OFF\n",
            "3 1 0\n",
            "OFF\n-5 1 0\n3 0 1 2",
        ] {
            let message = parse(text.as_bytes()).unwrap_err().to_string();
            println!("{message}");
        }
    }
}

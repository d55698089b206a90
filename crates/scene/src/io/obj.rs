//! Wavefront OBJ, with its MTL library, texture, and a RigNet `rig.txt` beside it.
//!
//! One part per `usemtl` run and object; a vertex per distinct (v, vt, vn). The raw `v` order is kept in a map, because `rig.txt` counts in
//! it (general readers re-index it away).

use super::text::{bad_line, lines, number, triple};
use super::{Format, ReadOptions, SceneError, load, mtl, plain, polygon, rig_txt};
use crate::{Asset, Look, Mesh, Part};
use glam::{DVec2, DVec3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The OBJ reader.
pub struct Obj;

impl Format for Obj {
    fn name(&self) -> &'static str {
        "obj"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["obj"]
    }

    fn summary(&self) -> &'static str {
        "Wavefront OBJ with MTL and texture; a RigNet rig.txt beside it gives the rig"
    }

    fn read(&self, bytes: Vec<u8>, path: &Path, options: &ReadOptions) -> Result<Asset, SceneError> {
        let mut model = parse(&bytes, path)?;
        model.finish();
        let mut asset = plain::asset(model.mesh, model.looks, options, model.warnings)?;
        if let Some(rig) = rig_beside(path) {
            let read = rig_txt::read(&rig)?;
            rig_txt::apply(&read, &mut asset, &model.raw_vertex, model.v.len()).map_err(|e| e.in_file(&rig))?;
        }
        Ok(asset)
    }
}

/// The `v` line of every vertex of the mesh read from an OBJ file, and the number of `v` lines: `rig.txt` counts in those.
///
/// # Errors
/// Those of reading the file.
pub fn raw_vertices(path: impl AsRef<Path>) -> Result<(Vec<u32>, usize), SceneError> {
    let path = path.as_ref();
    let model = parse(&load(path)?, path).map_err(|e| e.in_file(path))?;
    Ok((model.raw_vertex, model.v.len()))
}

/// `NAME.rig.txt`, `NAME_rig.txt` or `rig.txt` in the OBJ's folder.
fn rig_beside(path: &Path) -> Option<PathBuf> {
    let stem = path.file_stem()?.to_string_lossy();
    let names = [format!("{stem}.rig.txt"), format!("{stem}_rig.txt"), "rig.txt".to_string()];
    names.iter().map(|n| path.with_file_name(n)).find(|p| p.is_file())
}

/// A face corner: v, and vt and vn where given.
type Corner = (u32, Option<u32>, Option<u32>);

#[derive(Default)]
struct Model {
    v: Vec<DVec3>,
    v_colors: Vec<[f32; 3]>,
    vt: Vec<DVec2>,
    vn: Vec<DVec3>,
    mesh: Mesh,
    has_uv: bool,
    has_normal: bool,
    /// Mesh vertex → `v` line.
    raw_vertex: Vec<u32>,
    looks: Vec<Look>,
    warnings: Vec<String>,
    /// Vertices of the current part.
    seen: HashMap<Corner, u32>,
    name: String,
    look: Option<usize>,
}

fn parse(bytes: &[u8], path: &Path) -> Result<Model, SceneError> {
    let text = lines(bytes).replace("\\\r\n", " ").replace("\\\n", " ");
    let mut model = Model::default();
    for (i, line) in text.lines().enumerate() {
        model.statement(line, i + 1, path)?;
    }
    model.close_part();
    Ok(model)
}

impl Model {
    fn statement(&mut self, line: &str, at: usize, path: &Path) -> Result<(), SceneError> {
        let line = line.split('#').next().unwrap_or("").trim();
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let mut words = rest.split_whitespace();
        match key {
            "v" => self.position(rest, at)?,
            "vt" => {
                let u = number(words.next(), at)?;
                let v = words.next().map_or(Ok(0.0), |w| number(Some(w), at))?;
                // OBJ counts v upwards from the bottom, glTF downwards from the top.
                self.vt.push(DVec2::new(u, 1.0 - v));
            }
            "vn" => self.vn.push(triple(&mut words, at)?),
            "f" => self.face(words, at)?,
            "o" | "g" => {
                self.close_part();
                self.name = rest.trim().to_string();
            }
            "usemtl" => {
                self.close_part();
                self.look = Some(self.look_named(rest.trim()));
            }
            "mtllib" => {
                let library = path.with_file_name("").join(rest.trim().replace('\\', "/"));
                let looks = mtl::read(&library, &mut self.warnings);
                self.looks.extend(looks);
            }
            // Lines, curves, smoothing groups and whatever else do not change the surface.
            _ => {}
        }
        Ok(())
    }

    fn position(&mut self, rest: &str, at: usize) -> Result<(), SceneError> {
        let mut words = rest.split_whitespace();
        self.v.push(triple(&mut words, at)?);
        let extra: Vec<f64> = words.map(|w| number(Some(w), at)).collect::<Result<_, _>>()?;
        if let [r, g, b] = extra[..] {
            self.v_colors.resize(self.v.len() - 1, [1.0; 3]);
            let linear = |c: f64| crate::image::linear_from_srgb((c as f32).clamp(0.0, 1.0));
            self.v_colors.push([r, g, b].map(linear));
        }
        Ok(())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a str>, at: usize) -> Result<(), SceneError> {
        let corners: Vec<Corner> = words.map(|w| self.corner(w, at)).collect::<Result<_, _>>()?;
        if corners.len() < 3 {
            return Err(bad_line(at, format!("a face with {} corners", corners.len())));
        }
        let points: Vec<DVec3> = corners.iter().map(|c| self.v[c.0 as usize]).collect();
        let vertices: Vec<u32> = corners.iter().map(|&c| self.vertex(c)).collect();
        self.mesh.triangles.extend(polygon::triangulate(&points).iter().map(|t| t.map(|k| vertices[k])));
        Ok(())
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative numbers count from the end.
    fn corner(&self, word: &str, at: usize) -> Result<Corner, SceneError> {
        let mut fields = word.split('/');
        let mut index = |count: usize, what: &str| -> Result<Option<u32>, SceneError> {
            let Some(field) = fields.next().filter(|f| !f.is_empty()) else { return Ok(None) };
            let n: i64 = field.parse().map_err(|_| bad_line(at, format!("{word:?} is not a face corner")))?;
            let i = if n < 0 { n + count as i64 } else { n - 1 };
            if (0..count as i64).contains(&i) {
                Ok(Some(i as u32))
            } else {
                Err(bad_line(at, format!("{what} {n} of {count} in face corner {word:?}")))
            }
        };
        let v = index(self.v.len(), "vertex")?.ok_or_else(|| bad_line(at, format!("{word:?} is not a face corner")))?;
        Ok((v, index(self.vt.len(), "texture coordinate")?, index(self.vn.len(), "normal")?))
    }

    fn vertex(&mut self, corner: Corner) -> u32 {
        if let Some(&i) = self.seen.get(&corner) {
            return i;
        }
        let i = self.raw_vertex.len() as u32;
        self.seen.insert(corner, i);
        let (v, vt, vn) = corner;
        self.raw_vertex.push(v);
        self.mesh.positions.push(self.v[v as usize]);
        self.mesh.uvs.push(vt.map_or(DVec2::ZERO, |k| self.vt[k as usize]));
        self.mesh.normals.push(vn.map_or(DVec3::ZERO, |k| self.vn[k as usize].normalize_or_zero()));
        self.has_uv |= vt.is_some();
        self.has_normal |= vn.is_some();
        i
    }

    fn close_part(&mut self) {
        let vertices = self.mesh.parts.last().map_or(0, |p| p.vertices.end)..self.mesh.positions.len();
        let triangles = self.mesh.parts.last().map_or(0, |p| p.triangles.end)..self.mesh.triangles.len();
        if triangles.is_empty() {
            return;
        }
        let look = self.look.unwrap_or_else(|| self.look_named(""));
        self.mesh.parts.push(Part { name: self.name.clone(), vertices, triangles, look, skin: None });
        self.seen.clear();
    }

    /// The look of that name; a white one is added where no library defines it.
    fn look_named(&mut self, name: &str) -> usize {
        self.looks.iter().position(|l| l.name == name).unwrap_or_else(|| {
            self.looks.push(Look { name: name.to_string(), ..Look::default() });
            self.looks.len() - 1
        })
    }

    /// Drops attributes that no vertex had and fills vertex colours.
    fn finish(&mut self) {
        if !self.has_uv {
            self.mesh.uvs.clear();
        }
        if !self.has_normal {
            self.mesh.normals.clear();
        }
        if !self.v_colors.is_empty() {
            self.v_colors.resize(self.v.len(), [1.0; 3]);
            self.mesh.colors = self.raw_vertex.iter().map(|&v| self.v_colors[v as usize]).collect();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Asset, SceneError> {
        Obj.read(text.as_bytes().to_vec(), Path::new("no_such_folder/a.obj"), &ReadOptions::default())
    }

    const QUAD: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0.25\n";

    #[test]
    fn quads_are_split_seams_kept_and_uvs_turned_to_the_top_left() {
        let asset = read(&format!("{QUAD}f 1/1 2/2 3/1 4/1\nf 1/2 3/2 -1/1\n")).unwrap();
        assert_eq!(asset.mesh.triangles.len(), 3);
        assert_eq!((asset.mesh.positions.len(), asset.mesh.welded_count), (6, 4));
        assert_eq!(asset.mesh.uvs[1], DVec2::new(1.0, 0.75));
    }

    #[test]
    fn broken_faces_are_refused_with_the_line() {
        for face in ["f 1 2 9", "f 0 1 2", "f 1 2", "f 1 x 2", "f 1/7 2 3", "f -9 1 2"] {
            let message = read(&format!("{QUAD}{face}\n")).unwrap_err().to_string();
            assert!(message.contains("line 7"), "{face}: {message}");
        }
        assert!(read(QUAD).unwrap_err().to_string().contains("no triangles"));
    }
}

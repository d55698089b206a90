//! USD in its text form: a mesh per part, its points as time samples.

use super::CacheFormat;
use crate::{Asset, Part, Trajectory};
use glam::DVec3;
use std::io::Write;

pub struct Usda;

impl CacheFormat for Usda {
    fn extension(&self) -> &'static str {
        "usda"
    }

    fn write(&self, out: &mut dyn Write, asset: &Asset, trajectory: &Trajectory) -> std::io::Result<()> {
        let last = trajectory.frames.len().saturating_sub(1);
        writeln!(out, "#usda 1.0\n(\n    defaultPrim = \"model\"\n    upAxis = \"Y\"\n    startTimeCode = 0")?;
        writeln!(out, "    endTimeCode = {last}\n    timeCodesPerSecond = {}\n)\n", trajectory.fps)?;
        writeln!(out, "def Xform \"model\"\n{{")?;
        for (number, part) in asset.mesh.parts.iter().enumerate() {
            mesh(out, asset, trajectory, part, number)?;
        }
        writeln!(out, "}}")
    }
}

fn mesh(
    out: &mut dyn Write,
    asset: &Asset,
    trajectory: &Trajectory,
    part: &Part,
    number: usize,
) -> std::io::Result<()> {
    let mesh = &asset.mesh;
    let range = part.vertices.clone();
    let triangles = &mesh.triangles[part.triangles.clone()];
    writeln!(out, "    def Mesh \"{}\"\n    {{", identifier(&part.name, number))?;
    writeln!(out, "        uniform token subdivisionScheme = \"none\"")?;
    writeln!(out, "        int[] faceVertexCounts = [{}]", vec!["3"; triangles.len()].join(", "))?;
    let indices: Vec<String> = triangles.iter().flatten().map(|i| (*i as usize - range.start).to_string()).collect();
    writeln!(out, "        int[] faceVertexIndices = [{}]", indices.join(", "))?;
    writeln!(out, "        point3f[] points = [{}]", points(&mesh.positions[range.clone()]))?;
    writeln!(out, "        point3f[] points.timeSamples = {{")?;
    for (f, frame) in trajectory.frames.iter().enumerate() {
        writeln!(out, "            {f}: [{}],", points(&frame[range.clone()]))?;
    }
    writeln!(out, "        }}")?;
    if mesh.uvs.len() >= range.end {
        // USD counts v from the bottom.
        let uvs: Vec<String> =
            mesh.uvs[range].iter().map(|t| format!("({}, {})", t.x as f32, (1.0 - t.y) as f32)).collect();
        writeln!(
            out,
            "        texCoord2f[] primvars:st = [{}] (\n            interpolation = \"vertex\"\n        )",
            uvs.join(", ")
        )?;
    }
    writeln!(out, "    }}")
}

fn points(list: &[DVec3]) -> String {
    let words: Vec<String> = list
        .iter()
        .map(|p| {
            let p = p.as_vec3();
            format!("({}, {}, {})", p.x, p.y, p.z)
        })
        .collect();
    words.join(", ")
}

/// A name that USD takes, numbered so that it is the only one.
fn identifier(name: &str, number: usize) -> String {
    let safe: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let start = if safe.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') { "" } else { "part_" };
    format!("{start}{safe}_{number}")
}

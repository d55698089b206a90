//! `--repair`: mends a document before it is read, so that the reader stays strict and what is written back is sound too.
//!
//! Vertices that are not finite move onto a finite one and lose their triangles, triangles with missing vertices are dropped, unusable
//! influences get weight 0. Mended data go to new accessors; the original bytes stay.

use super::accessor::Document;
use super::container::Loaded;
use super::geometry::{expand, is_drawn};
use super::json::Place;
use super::write::{Output, Use};
use crate::io::SceneError;
use serde_json::json;

const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;

/// New data for one primitive.
struct Mended {
    mesh: usize,
    primitive: usize,
    positions: Option<Vec<[f32; 3]>>,
    indices: Option<Vec<u32>>,
    influences: Vec<InfluenceSet>,
}

/// New `JOINTS_n` and `WEIGHTS_n`.
struct InfluenceSet {
    set: usize,
    joints: Vec<u16>,
    weights: Vec<[f32; 4]>,
}

/// The document without what breaks it, and a warning for each thing mended.
pub(super) fn mend(mut loaded: Loaded) -> Result<Loaded, SceneError> {
    let mended = find(&Document::new(&loaded.json, &loaded.buffers)?, &mut loaded.warnings)?;
    if mended.is_empty() {
        return Ok(loaded);
    }
    let mut out = Output::patching(loaded.json, &loaded.buffers);
    for m in mended {
        let positions = m.positions.map(|p| out.floats(&p, Use::Vertices, true));
        let indices =
            m.indices.map(|i| out.integers(bytemuck::cast_slice(&i), UNSIGNED_INT, "SCALAR", i.len(), Use::Indices));
        let mut influences = Vec::new();
        for InfluenceSet { set, joints, weights } in m.influences {
            let bytes: Vec<u8> = joints.iter().flat_map(|j| j.to_le_bytes()).collect();
            let joints = out.integers(&bytes, UNSIGNED_SHORT, "VEC4", weights.len(), Use::Vertices);
            influences.push((set, joints, out.floats(&weights, Use::Vertices, false)));
        }
        let primitive = &mut out.json["meshes"][m.mesh]["primitives"][m.primitive];
        if let Some(accessor) = positions {
            primitive["attributes"]["POSITION"] = json!(accessor);
        }
        if let Some(accessor) = indices {
            primitive["indices"] = json!(accessor);
            primitive["mode"] = json!(4);
        }
        for (set, joints, weights) in influences {
            primitive["attributes"][format!("JOINTS_{set}")] = json!(joints);
            primitive["attributes"][format!("WEIGHTS_{set}")] = json!(weights);
        }
    }
    let (json, buffers) = out.into_parts();
    Ok(Loaded { json, buffers, warnings: loaded.warnings })
}

fn find(document: &Document, warnings: &mut Vec<String>) -> Result<Vec<Mended>, SceneError> {
    let mut found = Vec::new();
    for (m, mesh) in document.root.list("meshes")?.iter().enumerate() {
        let joints = joint_count(document, m)?;
        for (p, primitive) in mesh.list("primitives")?.iter().enumerate() {
            let mode = primitive.usize_or("mode", 4)?;
            if !is_drawn(primitive)? || primitive.path(&["extensions", "KHR_draco_mesh_compression"]).is_some() {
                continue;
            }
            let (positions, broken) = positions(document, primitive, warnings)?;
            let indices = indices(document, primitive, mode, &broken, warnings)?;
            let influences = match joints {
                Some(joints) => influences(document, primitive, joints, warnings)?,
                None => Vec::new(),
            };
            if positions.is_some() || indices.is_some() || !influences.is_empty() {
                found.push(Mended { mesh: m, primitive: p, positions, indices, influences });
            }
        }
    }
    Ok(found)
}

/// Joints of the smallest skin that is used with a mesh.
fn joint_count(document: &Document, mesh: usize) -> Result<Option<usize>, SceneError> {
    let mut smallest: Option<usize> = None;
    for node in document.root.list("nodes")? {
        let (Some(of), Some(skin)) = (node.get("mesh"), node.get("skin")) else { continue };
        if of.usize()? == mesh {
            let count = document.root.element("skins", skin.usize()?, &skin)?.len_of("joints");
            smallest = Some(smallest.map_or(count, |s| s.min(count)));
        }
    }
    Ok(smallest)
}

type Positions = (Option<Vec<[f32; 3]>>, Vec<bool>);

/// New positions if some are not finite, and which are not.
fn positions(document: &Document, primitive: &Place, warnings: &mut Vec<String>) -> Result<Positions, SceneError> {
    let stored = document.numbers(&primitive.need("attributes")?.need("POSITION")?)?;
    let rows: Vec<[f32; 3]> = stored.values.as_chunks::<3>().0.iter().map(|r| r.map(|x| x as f32)).collect();
    let broken: Vec<bool> = rows.iter().map(|r| !r.iter().all(|x| x.is_finite())).collect();
    let bad = broken.iter().filter(|b| **b).count();
    if bad == 0 {
        return Ok((None, broken));
    }
    let stand_in = rows.iter().zip(&broken).find(|(_, b)| !**b).map_or([0.0; 3], |(r, _)| *r);
    warnings.push(format!("repaired: dropped {bad} vertices of {} that are not finite", primitive.pointer));
    let mended = rows.iter().zip(&broken).map(|(r, b)| if *b { stand_in } else { *r }).collect();
    Ok((Some(mended), broken))
}

/// New indices if some triangles have to go.
fn indices(
    document: &Document,
    primitive: &Place,
    mode: usize,
    broken: &[bool],
    warnings: &mut Vec<String>,
) -> Result<Option<Vec<u32>>, SceneError> {
    let stored: Vec<u32> = match primitive.get("indices") {
        Some(accessor) => document.indices(&accessor)?,
        None => (0..broken.len() as u32).collect(),
    };
    let all = expand(mode, &stored);
    let sound = |t: &&[u32; 3]| t.iter().all(|&i| broken.get(i as usize) == Some(&false));
    let kept: Vec<[u32; 3]> = all.iter().filter(sound).copied().collect();
    if kept.len() == all.len() {
        return Ok(None);
    }
    warnings.push(format!("repaired: dropped {} triangles of {}", all.len() - kept.len(), primitive.pointer));
    Ok(Some(kept.into_flattened()))
}

/// New influences of the sets that hold unusable ones.
fn influences(
    document: &Document,
    primitive: &Place,
    joint_count: usize,
    warnings: &mut Vec<String>,
) -> Result<Vec<InfluenceSet>, SceneError> {
    let attributes = primitive.need("attributes")?;
    let mut sets = Vec::new();
    for set in 0.. {
        let (Some(j), Some(w)) = (attributes.get(&format!("JOINTS_{set}")), attributes.get(&format!("WEIGHTS_{set}")))
        else {
            break;
        };
        let (mut joints, mut weights) = (document.numbers(&j)?.values, document.numbers(&w)?.values);
        let mut bad = 0;
        for (joint, weight) in joints.iter_mut().zip(&mut weights) {
            let usable = *joint < joint_count as f64 && weight.is_finite() && *weight >= 0.0;
            if !usable {
                bad += usize::from(*weight != 0.0);
                (*joint, *weight) = (0.0, 0.0);
            }
        }
        if bad > 0 {
            warnings.push(format!("repaired: dropped {bad} unusable influences of {}", attributes.pointer));
            sets.push(InfluenceSet {
                set,
                joints: joints.iter().map(|&x| x as u16).collect(),
                weights: weights.as_chunks::<4>().0.iter().map(|r| r.map(|x| x as f32)).collect(),
            });
        }
    }
    Ok(sets)
}

//! Morph targets added to the document's meshes, with their weights as clips' channels.

use super::animation::times;
use super::bin::{Output, Use, array, push};
use super::rig::{PartPlace, own_mesh};
use crate::io::SceneError;
use crate::io::gltf::accessor::Document;
use crate::io::gltf::json::Place;
use crate::{Asset, Motion, Source};
use glam::DVec3;
use serde_json::{Value, json};

const FLOAT: u32 = 5126;

/// Shapes that are added to the stored positions before the skin, and how much of each a clip's frames show.
#[derive(Clone, Debug, Default)]
pub struct Morphs {
    /// Name \[target\].
    pub names: Vec<String>,
    /// Offsets of stored positions \[target\]\[vertex of the asset's mesh\].
    pub offsets: Vec<Vec<DVec3>>,
    /// Weights \[motion\]\[frame\]\[target\], in \[0, 1\].
    pub weights: Vec<Vec<Vec<f64>>>,
}

/// Adds the targets to every mesh that one of them moves, and the weights to the first animations, which are those of the motions.
pub(super) fn add(
    out: &mut Output,
    asset: &Asset,
    parts: &[PartPlace],
    motions: &[Motion],
    morphs: &Morphs,
) -> Result<(), SceneError> {
    let moved = |p: &PartPlace| morphs.offsets.iter().any(|o| o[p.vertices.clone()].iter().any(|d| *d != DVec3::ZERO));
    let mut nodes: Vec<usize> = parts.iter().filter(|p| moved(p)).map(|p| p.node).collect();
    nodes.dedup();
    let inputs: Vec<usize> = motions.iter().map(|m| out.floats(&times(m), Use::Other, true)).collect();
    for &node in &nodes {
        own_mesh(out, node);
        let mesh = out.json["nodes"][node]["mesh"].as_u64().unwrap_or(0) as usize;
        let old = targets(out, parts, node, mesh, morphs);
        let kept = widen_defaults(out, node, mesh, old, morphs);
        widen_old_clips(out, asset, node, old, motions.len(), morphs.names.len())?;
        for (clip, (input, frames)) in inputs.iter().zip(&morphs.weights).enumerate() {
            let rows: Vec<[f32; 1]> = frames.iter().flat_map(|f| kept.iter().chain(f)).map(|w| [*w as f32]).collect();
            let output = out.floats(&rows, Use::Other, false);
            let animation = &mut out.json["animations"][clip];
            let sampler =
                push(animation, "samplers", json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
            push(animation, "channels", json!({ "sampler": sampler, "target": { "node": node, "path": "weights" } }));
        }
    }
    Ok(())
}

/// Targets of all primitives of a mesh, zeros where nothing moves; returns how many there were before.
fn targets(out: &mut Output, parts: &[PartPlace], node: usize, mesh: usize, morphs: &Morphs) -> usize {
    let count = array(&mut out.json["meshes"][mesh], "primitives").len();
    let mut old = 0;
    for k in 0..count {
        let part = parts.iter().find(|p| p.node == node && p.primitive == k);
        for offsets in &morphs.offsets {
            let accessor = match part.map(|p| &offsets[p.vertices.clone()]) {
                Some(rows) if rows.iter().any(|d| *d != DVec3::ZERO) => {
                    let rows: Vec<[f32; 3]> = rows.iter().map(|d| d.as_vec3().to_array()).collect();
                    out.floats(&rows, Use::Vertices, true)
                }
                _ => {
                    let position = &out.json["meshes"][mesh]["primitives"][k]["attributes"]["POSITION"];
                    let count = out.json["accessors"][position.as_u64().unwrap_or(0) as usize]["count"].clone();
                    // An accessor without view is all zeros.
                    let zeros = json!({ "componentType": FLOAT, "count": count, "type": "VEC3",
                        "min": [0.0, 0.0, 0.0], "max": [0.0, 0.0, 0.0] });
                    push(&mut out.json, "accessors", zeros)
                }
            };
            let primitive = &mut out.json["meshes"][mesh]["primitives"][k];
            push(primitive, "targets", json!({ "POSITION": accessor }));
        }
        old = array(&mut out.json["meshes"][mesh]["primitives"][k], "targets").len() - morphs.offsets.len();
    }
    let names = &mut out.json["meshes"][mesh]["extras"];
    if !names.is_object() && old == 0 {
        *names = json!({});
    }
    let known = names["targetNames"].as_array().map_or(0, Vec::len);
    if known == old {
        morphs.names.iter().for_each(|n| {
            push(names, "targetNames", json!(n));
        });
    }
    old
}

/// Default weights of the new targets are 0; returns those of the old ones.
fn widen_defaults(out: &mut Output, node: usize, mesh: usize, old: usize, morphs: &Morphs) -> Vec<f64> {
    let read = |v: &Value| -> Option<Vec<f64>> {
        Some(v.get("weights")?.as_array()?.iter().map(|w| w.as_f64().unwrap_or(0.0)).collect())
    };
    let (of_node, of_mesh) = (read(&out.json["nodes"][node]), read(&out.json["meshes"][mesh]));
    let widened = |weights: &Option<Vec<f64>>| {
        let mut w = weights.clone().unwrap_or_default();
        w.resize(old, 0.0);
        let kept = w.clone();
        w.resize(old + morphs.names.len(), 0.0);
        (kept, w)
    };
    out.json["meshes"][mesh]["weights"] = json!(widened(&of_mesh).1);
    if of_node.is_some() {
        out.json["nodes"][node]["weights"] = json!(widened(&of_node).1);
    }
    widened(&of_node.or(of_mesh)).0
}

/// Clips of the document that move the old targets get zeros for the new ones.
fn widen_old_clips(
    out: &mut Output,
    asset: &Asset,
    node: usize,
    old: usize,
    first: usize,
    added: usize,
) -> Result<(), SceneError> {
    let Source::Gltf { json, buffers } = &asset.source else { return Ok(()) };
    let document = Document::new(json, buffers)?;
    let root = Place::root(json);
    for (k, clip) in root.list("animations")?.iter().enumerate() {
        let at = first + k;
        if out.json["animations"].get(at).is_none() || old == 0 {
            continue;
        }
        for (c, channel) in clip.list("channels")?.iter().enumerate() {
            let target = channel.need("target")?;
            if target.text("path") != "weights" || target.get("node").map(|n| n.usize()).transpose()? != Some(node) {
                continue;
            }
            let which = channel.need("sampler")?;
            let sampler = clip.list("samplers")?.into_iter().nth(which.usize()?);
            let output = sampler.ok_or_else(|| which.invalid("there is no such sampler"))?.need("output")?;
            let values = document.numbers(&output)?.values;
            let rows: Vec<[f32; 1]> = values
                .chunks(old)
                .flat_map(|row| row.iter().copied().chain(std::iter::repeat_n(0.0, added)))
                .map(|x| [x as f32])
                .collect();
            let accessor = out.floats(&rows, Use::Other, false);
            let animation = &mut out.json["animations"][at];
            let mut copy = animation["samplers"][which.usize()?].clone();
            copy["output"] = json!(accessor);
            let sampler = push(animation, "samplers", copy);
            animation["channels"][c]["sampler"] = json!(sampler);
        }
    }
    Ok(())
}

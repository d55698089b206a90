//! Joints that the document lacks: new nodes under the given ones, appended to the skins whose vertices they move.
//!
//! Only parts that a new joint moves get new weights (four, as every importer reads) and, where the displayed rest is not the bind pose, new
//! stored positions; a rigid part among them becomes skinned to its own node. All other parts, skins and nodes stay as they are.

use super::animation::unique;
use super::bin::{Output, Use, array, push};
use super::place;
use super::rig::{PartPlace, linear_map, own_mesh, primitive, rewind, safe_name, weigh};
use crate::io::SceneError;
use crate::io::gltf::accessor::Document;
use crate::io::gltf::geometry;
use crate::io::gltf::json::Place;
use crate::{Asset, Source};
use glam::{DMat4, DVec3};
use serde_json::{Value, json};

/// A skin of the document with joints appended.
struct Extended {
    /// The skin as it was, if there was one.
    original: Option<usize>,
    /// Where it is now.
    skin: usize,
    /// Appended slots, after the skin's own joints.
    slots: Vec<usize>,
}

/// Adds the joints without node. `nodes` \[joint\] is completed, and changed where a rigid part's node gets a stand-in.
pub(super) fn attach(
    out: &mut Output,
    asset: &Asset,
    parts: &[PartPlace],
    nodes: &mut [Option<usize>],
) -> Result<(), SceneError> {
    let skin = &asset.rig.skin;
    let is_new = |slot: usize| asset.rig.skeleton.joints[skin.slots[slot].joint].node.is_none();
    let slots_of = |part: &PartPlace| -> Vec<usize> {
        let mut all: Vec<usize> =
            skin.influences[part.vertices.clone()].iter().flatten().map(|i| i.slot as usize).collect();
        all.sort_unstable();
        all.dedup();
        all
    };
    let moved = |part: &PartPlace| slots_of(part).into_iter().any(is_new);
    let mut meshes: Vec<usize> = parts.iter().filter(|p| moved(p)).map(|p| p.node).collect();
    meshes.dedup();
    let rigid: Vec<usize> = meshes.iter().copied().filter(|&i| out.json["nodes"][i].get("skin").is_none()).collect();
    let changed: Vec<&PartPlace> = parts.iter().filter(|p| rigid.contains(&p.node) || moved(p)).collect();
    meshes.iter().for_each(|&node| own_mesh(out, node));
    for &i in &rigid {
        if let Source::Gltf { json, .. } = &asset.source
            && linear_map(json, i).matrix3.determinant() < 0.0
        {
            changed.iter().filter(|p| p.node == i).for_each(|part| rewind(out, asset, part));
        }
        let stand_in = place::free_from_hierarchy(&mut out.json, i);
        nodes.iter_mut().filter(|n| **n == Some(i)).for_each(|n| *n = Some(stand_in));
    }
    add_nodes(out, asset, nodes);
    let nodes: Vec<usize> = nodes.iter().map(|n| n.unwrap_or(0)).collect();
    let mut extended: Vec<Extended> = Vec::new();
    for &mesh in &meshes {
        let parts: Vec<&PartPlace> = changed.iter().copied().filter(|p| p.node == mesh).collect();
        let mut needed: Vec<usize> = parts.iter().flat_map(|p| slots_of(p)).collect();
        needed.sort_unstable();
        needed.dedup();
        let at = extend(out, asset, &nodes, &mut extended, mesh, &needed);
        let joints = joints_of(&out.json, extended[at].skin);
        for part in parts {
            weigh(out, skin, part, |slot| {
                let node = nodes[skin.slots[slot].joint];
                joints.iter().position(|j| *j == node).unwrap_or(0)
            });
            store(out, asset, part)?;
        }
    }
    extended.iter().try_for_each(|e| bind(out, asset, e))
}

/// Nodes for the joints that have none, at rest where their parents are.
fn add_nodes(out: &mut Output, asset: &Asset, nodes: &mut [Option<usize>]) {
    let mut names: Vec<String> =
        array(&mut out.json, "nodes").iter().filter_map(|n| n["name"].as_str()).map(safe_name).collect();
    for (j, joint) in asset.rig.skeleton.joints.iter().enumerate() {
        if nodes[j].is_some() {
            continue;
        }
        let index = push(&mut out.json, "nodes", json!({ "name": unique(&safe_name(&joint.name), &mut names) }));
        nodes[j] = Some(index);
        if let Some(parent) = joint.parent.and_then(|p| nodes[p]) {
            push(&mut out.json["nodes"][parent], "children", json!(index));
        }
    }
}

fn joints_of(json: &Value, skin: usize) -> Vec<usize> {
    let list = json["skins"][skin]["joints"].as_array();
    list.into_iter().flatten().filter_map(Value::as_u64).map(|j| j as usize).collect()
}

/// Gives a mesh node a skin that has all slots it needs: its own with joints appended, or a copy where another node needs that joint with another
/// inverse bind. Returns the place in `extended`.
fn extend(
    out: &mut Output,
    asset: &Asset,
    nodes: &[usize],
    extended: &mut Vec<Extended>,
    mesh: usize,
    needed: &[usize],
) -> usize {
    let slots = &asset.rig.skin.slots;
    let original = out.json["nodes"][mesh].get("skin").and_then(Value::as_u64).map(|s| s as usize);
    let own = original.map(|s| {
        let known = extended.iter().find(|e| e.original == Some(s)).map_or(0, |e| e.slots.len());
        let mut joints = joints_of(&out.json, s);
        joints.truncate(joints.len() - known);
        joints
    });
    let own = own.unwrap_or_default();
    let missing: Vec<usize> = needed.iter().copied().filter(|&s| !own.contains(&nodes[slots[s].joint])).collect();
    let fits = |e: &Extended| {
        let same = |s: &usize| e.slots.iter().all(|t| slots[*t].joint != slots[*s].joint || t == s);
        e.original.is_some() && e.original == original && missing.iter().all(same)
    };
    let at = extended.iter().position(fits).unwrap_or_else(|| {
        let taken = extended.iter().any(|e| e.original == original);
        let skin = match original {
            Some(s) if !taken => s,
            Some(s) => {
                let mut copy = out.json["skins"][s].clone();
                copy["joints"] = json!(own);
                push(&mut out.json, "skins", copy)
            }
            None => push(&mut out.json, "skins", json!({ "joints": [] })),
        };
        extended.push(Extended { original, skin, slots: Vec::new() });
        extended.len() - 1
    });
    let e = &mut extended[at];
    for s in missing {
        if !e.slots.contains(&s) {
            e.slots.push(s);
            push(&mut out.json["skins"][e.skin], "joints", json!(nodes[slots[s].joint]));
        }
    }
    out.json["nodes"][mesh]["skin"] = json!(e.skin);
    at
}

/// The inverse binds of an extended skin: its own, then those of the appended slots.
fn bind(out: &mut Output, asset: &Asset, extended: &Extended) -> Result<(), SceneError> {
    let Source::Gltf { json, buffers } = &asset.source else { return Ok(()) };
    let count = joints_of(&out.json, extended.skin).len() - extended.slots.len();
    let mut rows = vec![DMat4::IDENTITY.as_mat4().to_cols_array(); count];
    if let Some(original) = extended.original {
        let document = Document::new(json, buffers)?;
        let root = Place::root(json);
        let skin = root.element("skins", original, &root)?;
        if let Some(accessor) = skin.get("inverseBindMatrices") {
            for (row, stored) in rows.iter_mut().zip(document.numbers(&accessor)?.rows()) {
                *row = std::array::from_fn(|k| stored[k] as f32);
            }
        }
    }
    let slots = &asset.rig.skin.slots;
    rows.extend(extended.slots.iter().map(|&s| DMat4::from(slots[s].inverse_bind).as_mat4().to_cols_array()));
    let accessor = out.floats(&rows, Use::Other, false);
    let skin = &mut out.json["skins"][extended.skin];
    skin["inverseBindMatrices"] = json!(accessor);
    Ok(())
}

/// New stored positions where they differ from the document's.
fn store(out: &mut Output, asset: &Asset, part: &PartPlace) -> Result<(), SceneError> {
    let Source::Gltf { json, buffers } = &asset.source else { return Ok(()) };
    let document = Document::new(json, buffers)?;
    let root = Place::root(json);
    let node = root.element("nodes", part.node, &root)?;
    let mesh = node.need("mesh")?;
    let mesh = root.element("meshes", mesh.usize()?, &mesh)?;
    let source = mesh.list("primitives")?.swap_remove(part.primitive);
    let position = source.need("attributes")?.need("POSITION")?;
    let weights = node.get("weights").or_else(|| mesh.get("weights"));
    let was = geometry::positions(&document, weights, &source, &position)?;
    let now = &asset.rig.skin.bind_positions[part.vertices.clone()];
    if was.iter().zip(now).all(|(a, b)| a.as_vec3() == b.as_vec3()) {
        return Ok(());
    }
    let stored = document.numbers(&position)?;
    let rows: Vec<[f32; 3]> = stored
        .rows()
        .zip(was.iter().zip(now))
        .map(|(row, (was, now))| (DVec3::from_slice(row) + (*now - *was)).as_vec3().to_array())
        .collect();
    let accessor = out.floats(&rows, Use::Vertices, true);
    primitive(&mut out.json, part)["attributes"]["POSITION"] = json!(accessor);
    Ok(())
}

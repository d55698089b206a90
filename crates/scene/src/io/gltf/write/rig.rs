//! Attaches a rig that we made: one joint tree under one root joint, rigid inverse binds, four influences; meshes at the scene root.

use super::animation::unique;
use super::bin::{Output, Use, array, push};
use super::place;
use crate::io::SceneError;
use crate::io::gltf::accessor::Document;
use crate::io::gltf::geometry::is_drawn;
use crate::io::gltf::json::Place;
use crate::rig::{Influence, Skeleton, Skin};
use crate::{Asset, Source};
use glam::{DAffine3, DMat4, DVec3};
use serde_json::{Value, json};
use std::ops::Range;

/// Influences per vertex that every importer reads.
const INFLUENCES: usize = 4;
/// Weights are multiples of 1/GRID, which f32 adds up to 1 without rounding in any order.
const GRID: f64 = 8_388_608.0;
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;

/// Where a part of the mesh lives in the document, and its vertices and triangles.
pub(super) struct PartPlace {
    pub node: usize,
    pub primitive: usize,
    pub vertices: Range<usize>,
    pub triangles: Range<usize>,
}

/// The primitives of a document in the reader's order, with the vertices of the mesh they became.
pub(super) fn parts_of(json: &Value, asset: &Asset) -> Result<Vec<PartPlace>, SceneError> {
    let root = Place::root(json);
    let mut parts = asset.mesh.parts.iter();
    let shown = shown(json);
    let mut out = Vec::new();
    for (node, place) in root.list("nodes")?.iter().enumerate().filter(|(i, _)| shown[*i]) {
        let Some(mesh) = place.get("mesh") else { continue };
        let primitives = root.element("meshes", mesh.usize()?, &mesh)?.list("primitives")?;
        for (primitive, p) in primitives.iter().enumerate() {
            if !is_drawn(p)? {
                continue;
            }
            let part =
                parts.next().ok_or_else(|| SceneError::Caller("the mesh has fewer parts than its document".into()))?;
            out.push(PartPlace { node, primitive, vertices: part.vertices.clone(), triangles: part.triangles.clone() });
        }
    }
    Ok(out)
}

/// Whether the default scene shows each node.
fn shown(json: &Value) -> Vec<bool> {
    let nodes = json["nodes"].as_array().map_or(&[][..], Vec::as_slice);
    let index = json.get("scene").and_then(Value::as_u64).unwrap_or(0) as usize;
    let Some(scene) = json["scenes"].get(index) else { return vec![true; nodes.len()] };
    let ids = |v: &Value, key: &str| -> Vec<usize> {
        v[key].as_array().into_iter().flatten().filter_map(Value::as_u64).map(|n| n as usize).collect()
    };
    let (mut shown, mut stack) = (vec![false; nodes.len()], ids(scene, "nodes"));
    while let Some(i) = stack.pop() {
        if i < nodes.len() && !std::mem::replace(&mut shown[i], true) {
            stack.extend(ids(&nodes[i], "children"));
        }
    }
    shown
}

/// Adds joints, skin and weights, bakes the parts to where they are displayed, and returns the node of each joint.
pub(super) fn attach(out: &mut Output, asset: &Asset, parts: &[PartPlace]) -> Result<Vec<usize>, SceneError> {
    let mut meshes: Vec<usize> = parts.iter().map(|p| p.node).collect();
    meshes.dedup();
    meshes.iter().rev().for_each(|&node| own_mesh(out, node));
    for part in parts {
        bake(out, asset, part)?;
        weigh(out, &asset.rig.skin, part, |slot| asset.rig.skin.slots[slot].joint);
    }
    place::to_root(&mut out.json, &meshes);
    let (nodes, joints) = joint_tree(out, &asset.rig.skeleton);
    let world = asset.rig.skeleton.rest_world();
    let mut binds: Vec<[f32; 16]> = world.iter().map(|w| DMat4::from(w.inverse()).as_mat4().to_cols_array()).collect();
    binds.resize(joints.len(), DMat4::IDENTITY.as_mat4().to_cols_array());
    let accessor = out.floats(&binds, Use::Other, false);
    let root = joints.last().copied().filter(|_| joints.len() > nodes.len()).or(nodes.first().copied());
    let skin = push(
        &mut out.json,
        "skins",
        json!({ "name": "animimic", "joints": joints, "inverseBindMatrices": accessor, "skeleton": root }),
    );
    for node in meshes {
        out.json["nodes"][node]["skin"] = json!(skin);
    }
    Ok(nodes)
}

/// Gives a node a mesh that no other node shows.
pub(super) fn own_mesh(out: &mut Output, node: usize) {
    let mesh = out.json["nodes"][node]["mesh"].clone();
    let nodes = array(&mut out.json, "nodes");
    if nodes.iter().enumerate().any(|(i, n)| i != node && n.get("mesh") == Some(&mesh)) {
        let copy = out.json["meshes"][mesh.as_u64().unwrap_or(0) as usize].clone();
        let new = push(&mut out.json, "meshes", copy);
        out.json["nodes"][node]["mesh"] = json!(new);
    }
}

pub(super) fn primitive<'a>(json: &'a mut Value, part: &PartPlace) -> &'a mut Value {
    let mesh = json["nodes"][part.node]["mesh"].as_u64().unwrap_or(0) as usize;
    &mut json["meshes"][mesh]["primitives"][part.primitive]
}

/// New positions, normals and winding where the part was displayed elsewhere than its buffer says.
fn bake(out: &mut Output, asset: &Asset, part: &PartPlace) -> Result<(), SceneError> {
    let (stored, json) = match &asset.source {
        // A document made from scratch stores what is displayed.
        Source::Plain => return Ok(()),
        Source::Gltf { json, buffers } => (Document::new(json, buffers)?, json),
    };
    let root = Place::root(json);
    let node = root.element("nodes", part.node, &root)?;
    let mesh = node.need("mesh")?;
    let source = root.element("meshes", mesh.usize()?, &mesh)?.list("primitives")?.swap_remove(part.primitive);
    let attributes = source.need("attributes")?;
    let target = &asset.mesh.positions[part.vertices.clone()];
    let old = stored.numbers(&attributes.need("POSITION")?)?;
    let unmoved = old.rows().zip(target).all(|(r, p)| DVec3::from_slice(r).as_vec3() == p.as_vec3());
    if unmoved {
        return Ok(());
    }
    let linear = linear_map(json, part.node);
    let positions: Vec<[f32; 3]> = target.iter().map(|p| p.as_vec3().to_array()).collect();
    let accessor = out.floats(&positions, Use::Vertices, true);
    primitive(&mut out.json, part)["attributes"]["POSITION"] = json!(accessor);
    if attributes.get("NORMAL").is_some() {
        let normals: Vec<[f32; 3]> =
            asset.mesh.normals[part.vertices.clone()].iter().map(|n| n.as_vec3().to_array()).collect();
        let accessor = out.floats(&normals, Use::Vertices, false);
        primitive(&mut out.json, part)["attributes"]["NORMAL"] = json!(accessor);
    }
    if let Some(place) = attributes.get("TANGENT") {
        let sign = linear.matrix3.determinant().signum();
        let turned = |r: &[f64]| {
            let t = (linear.matrix3 * DVec3::from_slice(r)).normalize_or(DVec3::X).as_vec3();
            [t.x, t.y, t.z, (r[3] * sign) as f32]
        };
        let tangents: Vec<[f32; 4]> = stored.numbers(&place)?.rows().map(turned).collect();
        let accessor = out.floats(&tangents, Use::Vertices, false);
        primitive(&mut out.json, part)["attributes"]["TANGENT"] = json!(accessor);
    }
    for (k, morph) in source.list("targets")?.iter().enumerate() {
        for key in ["POSITION", "NORMAL", "TANGENT"] {
            let Some(place) = morph.get(key) else { continue };
            let offsets = stored.numbers(&place)?;
            let turned: Vec<[f32; 3]> =
                offsets.rows().map(|r| (linear.matrix3 * DVec3::from_slice(r)).as_vec3().to_array()).collect();
            let accessor = out.floats(&turned, Use::Vertices, key == "POSITION");
            primitive(&mut out.json, part)["targets"][k][key] = json!(accessor);
        }
    }
    if linear.matrix3.determinant() < 0.0 {
        rewind(out, asset, part);
    }
    Ok(())
}

/// Displayed triangles as new indices: a mirroring node had turned them.
pub(super) fn rewind(out: &mut Output, asset: &Asset, part: &PartPlace) {
    let first = part.vertices.start as u32;
    let indices: Vec<u32> = asset.mesh.triangles[part.triangles.clone()].iter().flatten().map(|i| i - first).collect();
    let accessor = out.integers(bytemuck::cast_slice(&indices), UNSIGNED_INT, "SCALAR", indices.len(), Use::Indices);
    let primitive = primitive(&mut out.json, part);
    primitive["indices"] = json!(accessor);
    primitive["mode"] = json!(4);
}

/// World transform of a node in the document.
pub(super) fn linear_map(json: &Value, node: usize) -> DAffine3 {
    let mut warnings = Vec::new();
    let buffers: [Vec<u8>; 0] = [];
    let world = Document::plain(json, &buffers);
    let graph = crate::io::gltf::nodes::Graph::new(&world, &mut warnings);
    let Ok(graph) = graph else { return DAffine3::IDENTITY };
    let (mut map, mut next) = (DAffine3::IDENTITY, Some(node));
    while let Some(i) = next {
        map = graph.nodes[i].rest.affine() * map;
        next = graph.nodes[i].parent;
    }
    map
}

/// JOINTS_0 and WEIGHTS_0 of a part; `joint_of` gives the place of a slot's joint in the document's skin.
pub(super) fn weigh(out: &mut Output, skin: &Skin, part: &PartPlace, joint_of: impl Fn(usize) -> usize) {
    let rows: Vec<([u16; 4], [f32; 4])> =
        skin.influences[part.vertices.clone()].iter().map(|list| four(list, &joint_of)).collect();
    let weights: Vec<[f32; 4]> = rows.iter().map(|r| r.1).collect();
    let small = rows.iter().flat_map(|r| r.0).all(|j| j <= u16::from(u8::MAX));
    let (bytes, component): (Vec<u8>, u32) = if small {
        (rows.iter().flat_map(|r| r.0).map(|j| j as u8).collect(), UNSIGNED_BYTE)
    } else {
        (rows.iter().flat_map(|r| r.0).flat_map(u16::to_le_bytes).collect(), UNSIGNED_SHORT)
    };
    let joints = out.integers(&bytes, component, "VEC4", rows.len(), Use::Vertices);
    let weights = out.floats(&weights, Use::Vertices, false);
    let attributes = &mut primitive(&mut out.json, part)["attributes"];
    if let Some(object) = attributes.as_object_mut() {
        object.retain(|key, _| !key.starts_with("JOINTS_") && !key.starts_with("WEIGHTS_"));
    }
    attributes["JOINTS_0"] = json!(joints);
    attributes["WEIGHTS_0"] = json!(weights);
}

/// The four largest weights, summing to 1 in f32, no joint twice, unused places 0.
fn four(list: &[Influence], joint_of: &impl Fn(usize) -> usize) -> ([u16; 4], [f32; 4]) {
    let mut merged: Vec<(usize, f64)> = Vec::new();
    for i in list {
        let joint = joint_of(i.slot as usize);
        match merged.iter_mut().find(|(j, _)| *j == joint) {
            Some(pair) => pair.1 += i.weight,
            None => merged.push((joint, i.weight)),
        }
    }
    merged.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    merged.truncate(INFLUENCES);
    let sum: f64 = merged.iter().map(|p| p.1).sum();
    let (mut joints, mut weights) = ([0u16; 4], [0.0f32; 4]);
    for (k, (joint, weight)) in merged.iter().enumerate() {
        weights[k] = ((weight / sum * GRID).round() / GRID) as f32;
        if weights[k] > 0.0 {
            joints[k] = *joint as u16;
        }
    }
    // Rounding is taken up by the largest; on the grid all of these sums are exact.
    weights[0] = 1.0 - (weights[1] + weights[2] + weights[3]);
    (joints, weights)
}

/// Nodes for all joints under one root, which is the last of the skin's joints if it had to be made. Returns (node of each joint, the skin's joints).
fn joint_tree(out: &mut Output, skeleton: &Skeleton) -> (Vec<usize>, Vec<usize>) {
    let mut names: Vec<String> =
        array(&mut out.json, "nodes").iter().filter_map(|n| n["name"].as_str()).map(safe_name).collect();
    let first = array(&mut out.json, "nodes").len();
    for joint in &skeleton.joints {
        let r = &joint.rest;
        let mut node = json!({ "name": unique(&safe_name(&joint.name), &mut names) });
        node["translation"] = json!(r.translation.as_vec3().to_array());
        node["rotation"] = json!(r.rotation.as_quat().normalize().to_array());
        if r.scale != DVec3::ONE {
            node["scale"] = json!(r.scale.as_vec3().to_array());
        }
        let index = push(&mut out.json, "nodes", node);
        if let Some(p) = joint.parent {
            push(&mut out.json["nodes"][first + p], "children", json!(index));
        }
    }
    let nodes: Vec<usize> = (first..first + skeleton.joints.len()).collect();
    let roots: Vec<usize> =
        skeleton.joints.iter().zip(&nodes).filter(|(j, _)| j.parent.is_none()).map(|(_, &n)| n).collect();
    let mut joints = nodes.clone();
    let mut root = roots.first().copied().unwrap_or(first);
    if roots.len() > 1 {
        let node = json!({ "name": unique("armature_root", &mut names), "children": roots });
        root = push(&mut out.json, "nodes", node);
        joints.push(root);
    }
    let scene = out.json.get("scene").and_then(Value::as_u64).unwrap_or(0) as usize;
    if let Some(scene) = array(&mut out.json, "scenes").get_mut(scene) {
        push(scene, "nodes", json!(root));
    }
    (nodes, joints)
}

/// A name without the characters that three.js deletes.
pub(super) fn safe_name(name: &str) -> String {
    let name: String = name
        .chars()
        .filter(|c| !matches!(c, '[' | ']' | '.' | ':' | '/'))
        .map(|c| if c.is_whitespace() { '_' } else { c })
        .collect();
    if name.is_empty() { "joint".into() } else { name }
}

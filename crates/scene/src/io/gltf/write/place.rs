//! Skinned mesh nodes go to the scene root with the identity: glTF ignores their own transform, importers do not all.

use super::bin::{array, push};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

const TRANSFORM: [&str; 4] = ["translation", "rotation", "scale", "matrix"];

/// Moves every skinned mesh node to the scene root. Where such a node has children or is a joint itself, a new node takes its place in the
/// hierarchy; the map gives old → new index of those.
pub(super) fn skinned_meshes_to_root(json: &mut Value) -> BTreeMap<usize, usize> {
    let count = json["nodes"].as_array().map_or(0, Vec::len);
    let skinned: Vec<usize> = (0..count)
        .filter(|&i| json["nodes"][i].get("mesh").is_some() && json["nodes"][i].get("skin").is_some())
        .collect();
    to_root(json, &skinned)
}

/// Moves the given mesh nodes to the root of the scenes that show them, with identity transforms.
pub(super) fn to_root(json: &mut Value, meshes: &[usize]) -> BTreeMap<usize, usize> {
    let mut stand_ins = BTreeMap::new();
    for &i in meshes {
        let node = &json["nodes"][i];
        let has_children = node["children"].as_array().is_some_and(|c| !c.is_empty());
        if has_children || is_joint(json, i) {
            stand_ins.insert(i, replace(json, i));
        } else {
            detach(json, i);
        }
        if let Some(node) = json["nodes"][i].as_object_mut() {
            TRANSFORM.iter().for_each(|key| {
                node.shift_remove(*key);
            });
        }
    }
    retarget_animations(json, &stand_ins);
    stand_ins
}

/// Moves a mesh node that hangs in the hierarchy to the root and returns the node that takes its place there, as a joint may.
pub(super) fn free_from_hierarchy(json: &mut Value, mesh: usize) -> usize {
    let stand_in = replace(json, mesh);
    retarget_animations(json, &BTreeMap::from([(mesh, stand_in)]));
    stand_in
}

fn is_joint(json: &Value, node: usize) -> bool {
    let skins = json.get("skins").and_then(Value::as_array);
    skins.is_some_and(|s| {
        s.iter().filter_map(|s| s["joints"].as_array()).flatten().any(|j| j.as_u64() == Some(node as u64))
    })
}

fn lists(json: &mut Value, node: usize) -> Vec<(&mut Vec<Value>, usize)> {
    let Some(root) = json.as_object_mut() else { return Vec::new() };
    let mut found = Vec::new();
    for (key, member) in root.iter_mut() {
        let inner = match key.as_str() {
            "nodes" => "children",
            "scenes" => "nodes",
            "skins" => "joints",
            _ => continue,
        };
        for item in member.as_array_mut().into_iter().flatten() {
            if let Some(list) = item.get_mut(inner).and_then(Value::as_array_mut)
                && let Some(at) = list.iter().position(|v| v.as_u64() == Some(node as u64))
            {
                found.push((list, at));
            }
        }
    }
    found
}

/// A new node with the transform and the children of `i` takes its place; `i` keeps the rest and goes to the scene root.
fn replace(json: &mut Value, i: usize) -> usize {
    let mut stand_in = Map::new();
    if let Some(node) = json["nodes"][i].as_object_mut() {
        for key in TRANSFORM.iter().chain(&["children"]) {
            if let Some(value) = node.shift_remove(*key) {
                stand_in.insert((*key).to_string(), value);
            }
        }
        if let Some(name) = node.get("name").and_then(Value::as_str) {
            stand_in.insert("name".into(), json!(format!("{name}_node")));
        }
    }
    let new = push(json, "nodes", Value::Object(stand_in));
    lists(json, i).into_iter().for_each(|(list, at)| list[at] = json!(new));
    let above = line_of(json, new);
    add_to_scenes(json, i, &above);
    new
}

fn detach(json: &mut Value, i: usize) {
    let above = line_of(json, i);
    if above.len() == 1 {
        return;
    }
    for node in array(json, "nodes") {
        let Some(children) = node.get_mut("children").and_then(Value::as_array_mut) else { continue };
        children.retain(|c| c.as_u64() != Some(i as u64));
        if children.is_empty()
            && let Some(object) = node.as_object_mut()
        {
            object.shift_remove("children");
        }
    }
    add_to_scenes(json, i, &above);
}

/// Adds `node` to every scene that shows one of `relatives`, unless it is there.
fn add_to_scenes(json: &mut Value, node: usize, relatives: &[usize]) {
    for scene in array(json, "scenes") {
        let list = array(scene, "nodes");
        let holds = |list: &[Value], i: usize| list.iter().any(|n| n.as_u64() == Some(i as u64));
        if !holds(list, node) && relatives.iter().any(|&r| holds(list, r)) {
            list.push(json!(node));
        }
    }
}

/// A node and all above it.
fn line_of(json: &Value, node: usize) -> Vec<usize> {
    let nodes = json["nodes"].as_array().map_or(&[][..], Vec::as_slice);
    let is_child =
        |n: &Value, i: usize| n["children"].as_array().is_some_and(|c| c.iter().any(|v| v.as_u64() == Some(i as u64)));
    let mut line = vec![node];
    while let Some(parent) = nodes.iter().position(|n| is_child(n, line[line.len() - 1])) {
        line.push(parent);
    }
    line
}

fn retarget_animations(json: &mut Value, stand_ins: &BTreeMap<usize, usize>) {
    if stand_ins.is_empty() {
        return;
    }
    for animation in array(json, "animations") {
        for channel in array(animation, "channels") {
            let target = &mut channel["target"];
            // Morph weights stay with the mesh.
            let moves = target["path"].as_str() != Some("weights");
            let new = target["node"].as_u64().and_then(|n| stand_ins.get(&(n as usize)));
            if let (true, Some(new)) = (moves, new) {
                target["node"] = json!(new);
            }
        }
    }
}

//! Exact truth of a motion, for scoring only: a folder with `gt.npz`, `masks.npz`, `camera.json`, `meta.json` and `static.glb`.

use crate::Error;
use animimic_scene::io::{self, npz};
use animimic_scene::{Asset, CameraFile, Mask, Source};
use glam::DVec3;
use std::path::Path;

/// What really happened.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// Vertices in the file's order, world space, \[frame\]\[vertex\].
    pub vertices: Vec<Vec<DVec3>>,
    /// Whether the input camera sees a vertex, \[frame\]\[vertex\]; empty if unknown.
    pub visible: Vec<Vec<bool>>,
    /// Joints in world space, \[frame\]\[joint\]; empty if unknown.
    pub joints: Vec<Vec<DVec3>>,
    /// Name and glTF node index of each joint.
    pub joint_names: Vec<(String, Option<usize>)>,
    /// Silhouettes by view name, \[frame\].
    pub masks: Vec<(String, Vec<Mask>)>,
    /// The views.
    pub camera: Option<CameraFile>,
    /// The model in its first pose with its rig, where the folder has it.
    pub still: Option<Asset>,
    /// The motion goes beyond the skeleton (soft tissue): joints are not compared.
    pub soft: bool,
}

/// Weights up to this do not count as moving anything (stored weights are rounded to 1/255 at the coarsest).
const LEAST_WEIGHT: f64 = 1e-3;

impl Truth {
    /// Joints that carry weight themselves or through a descendant in the still model; none where it is absent.
    pub fn joints_that_move_something(&self) -> Vec<usize> {
        let Some(still) = &self.still else { return Vec::new() };
        let joints = &still.rig.skeleton.joints;
        let mut live = vec![false; joints.len()];
        for i in still.rig.skin.influences.iter().flatten().filter(|i| i.weight > LEAST_WEIGHT) {
            live[still.rig.skin.slots[i.slot as usize].joint] = true;
        }
        for j in (0..joints.len()).rev() {
            if let (true, Some(p)) = (live[j], joints[j].parent) {
                live[p] = true;
            }
        }
        let names: Vec<String> =
            joints.iter().zip(&live).filter(|(_, l)| **l).map(|(j, _)| three_js_name(&j.name)).collect();
        (0..self.joint_names.len()).filter(|&k| names.contains(&three_js_name(&self.joint_names[k].0))).collect()
    }

    /// The joint of a result that stands for joint `k`: the same node if its name agrees, else the only one of that name.
    pub fn joint_in(&self, k: usize, result: &Asset) -> Option<usize> {
        let wanted = three_js_name(&self.joint_names[k].0);
        let joints = &result.rig.skeleton.joints;
        let by_node = self.joint_names[k].1.and_then(|n| {
            let j = joints.iter().position(|j| j.node == Some(n))?;
            let name = three_js_name(&joints[j].name);
            // three.js numbers equal names: `foot`, `foot_1`.
            (name == wanted || wanted.starts_with(&(name + "_"))).then_some(j)
        });
        by_node.or_else(|| {
            let same: Vec<usize> = (0..joints.len()).filter(|&j| three_js_name(&joints[j].name) == wanted).collect();
            (same.len() == 1 && nodes_named(result, &wanted) <= 1).then(|| same[0])
        })
    }
}

/// Reads a folder of truth: `gt.npz` and `meta.json` are required, the rest is taken where it is.
///
/// # Errors
/// [`Error::Scene`] for broken files, [`Error::Input`] where arrays do not belong together.
pub fn read(folder: &Path) -> Result<Truth, Error> {
    let gt = npz::read(folder.join("gt.npz"))?;
    let meta = folder.join("meta.json");
    let meta: serde_json::Value = serde_json::from_slice(&std::fs::read(&meta).map_err(Error::io(&meta))?)
        .map_err(|e| Error::Input(format!("{}: not JSON: {e}", meta.display())))?;
    let broken = |what: &str| Error::Input(format!("{}: {what}", folder.join("gt.npz").display()));
    let unique = points(gt.need("verts_unique")?).ok_or_else(|| broken("verts_unique should be frames × n × 3"))?;
    let map: Vec<usize> = gt.need("vert_to_unique")?.to_f64().iter().map(|&i| i as usize).collect();
    if unique.is_empty() || map.is_empty() || map.iter().any(|&i| i >= unique[0].len()) {
        return Err(broken("vert_to_unique points outside verts_unique"));
    }
    let vertices: Vec<Vec<DVec3>> = unique.iter().map(|f| map.iter().map(|&i| f[i]).collect()).collect();
    let visible = match gt.get("visible") {
        Some(a) => bits(a, map.len()).ok_or_else(|| broken("visible should be frames × packed bits"))?,
        None => Vec::new(),
    };
    let joints = match gt.get("joint_pos") {
        Some(a) => points(a).ok_or_else(|| broken("joint_pos should be frames × joints × 3"))?,
        None => Vec::new(),
    };
    let joint_names = if joints.is_empty() { Vec::new() } else { joint_names(&meta) };
    let existing = |name: &str| Some(folder.join(name)).filter(|p| p.is_file());
    let camera = existing("camera.json").map(io::camera_json::read).transpose()?;
    let masks = match (&camera, existing("masks.npz")) {
        (Some(camera), Some(path)) => masks(&npz::read(path)?, camera.main.width as usize),
        _ => Vec::new(),
    };
    let still = existing("static.glb").map(io::read).transpose()?;
    Ok(Truth { vertices, visible, joints, joint_names, masks, camera, still, soft: existing("soft.npz").is_some() })
}

/// Frames × n × 3 numbers as points.
fn points(array: &npz::Array) -> Option<Vec<Vec<DVec3>>> {
    let &[_, n, 3] = array.shape.as_slice() else { return None };
    let numbers = array.to_f64();
    let all: Vec<DVec3> = numbers.chunks_exact(3).map(DVec3::from_slice).collect();
    (n > 0).then(|| all.chunks_exact(n).map(<[DVec3]>::to_vec).collect())
}

/// Rows of bits, packed from the highest bit of each byte (`numpy.packbits`), cut to `count` a row.
fn bits(array: &npz::Array, count: usize) -> Option<Vec<Vec<bool>>> {
    let bytes = array.to_u8()?;
    let row = *array.shape.last()?;
    (row * 8 >= count && row > 0).then(|| {
        bytes.chunks_exact(row).map(|r| (0..count).map(|i| r[i / 8] & (128 >> (i % 8)) != 0).collect()).collect()
    })
}

/// All arrays frames × height × packed columns as masks.
fn masks(archive: &npz::Archive, width: usize) -> Vec<(String, Vec<Mask>)> {
    let mut out = Vec::new();
    for (name, array) in &archive.arrays {
        let &[_, height, _] = array.shape.as_slice() else { continue };
        let Some(rows) = bits(array, width) else { continue };
        let frame = |rows: &[Vec<bool>]| Mask {
            width,
            height,
            coverage: rows.iter().flatten().map(|&b| if b { 255 } else { 0 }).collect(),
        };
        out.push((name.clone(), rows.chunks_exact(height.max(1)).map(frame).collect()));
    }
    out
}

fn joint_names(meta: &serde_json::Value) -> Vec<(String, Option<usize>)> {
    let joints = meta["joints"].as_array().map_or(&[][..], |j| j);
    let node = |j: &serde_json::Value| j["node"].as_u64().map(|n| n as usize);
    joints.iter().map(|j| (j["name"].as_str().unwrap_or_default().to_owned(), node(j))).collect()
}

/// Number of nodes of that name in the asset's document.
fn nodes_named(asset: &Asset, wanted: &str) -> usize {
    let Source::Gltf { json, .. } = &asset.source else { return 0 };
    let nodes = json["nodes"].as_array().map_or(&[][..], |n| n);
    nodes.iter().filter(|n| three_js_name(n["name"].as_str().unwrap_or_default()) == wanted).count()
}

/// A node name as three.js keeps it: white space becomes `_`, and `[ ] . : /` are dropped.
pub fn three_js_name(name: &str) -> String {
    name.chars()
        .filter(|c| !matches!(c, '[' | ']' | '.' | ':' | '/'))
        .map(|c| if c.is_whitespace() { '_' } else { c })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_scene::{Influence, Joint, Rig, Skeleton, Skin, Slot, Transform};

    fn asset(joints: &[(&str, Option<usize>, usize)], weighted: &[usize]) -> Asset {
        let joints = joints
            .iter()
            .map(|&(name, parent, node)| Joint {
                name: name.into(),
                parent,
                rest: Transform::IDENTITY,
                node: Some(node),
            })
            .collect();
        let slots = weighted.iter().map(|&joint| Slot { joint, inverse_bind: glam::DAffine3::IDENTITY }).collect();
        let influences = (0..weighted.len()).map(|s| vec![Influence { slot: s as u32, weight: 1.0 }]).collect();
        let skin = Skin { slots, bind_positions: vec![DVec3::ZERO; weighted.len()], influences };
        Asset { rig: Rig { skeleton: Skeleton { joints }, skin }, ..Asset::default() }
    }

    #[test]
    fn joints_count_when_they_or_their_descendants_carry_weight_and_are_found_by_node_or_unique_name() {
        let still = asset(&[("root", None, 0), ("arm.L", Some(0), 1), ("nub", Some(0), 2)], &[1]);
        let truth = Truth {
            joint_names: vec![("root".into(), Some(0)), ("armL".into(), Some(1)), ("nub".into(), Some(2))],
            still: Some(still.clone()),
            ..Truth::default()
        };
        assert_eq!(truth.joints_that_move_something(), [0, 1]);
        assert_eq!(truth.joint_in(1, &still), Some(1));
        let renumbered = asset(&[("x", None, 0), ("root", Some(0), 5), ("arm.L", Some(1), 9)], &[2]);
        assert_eq!(truth.joint_in(1, &renumbered), Some(2));
        assert_eq!(truth.joint_in(2, &renumbered), None);
    }
}

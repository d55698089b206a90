//! RigNet's `rig.txt`: `joints NAME x y z`, `root NAME`, `hier PARENT CHILD`, `skin VERTEX JOINT WEIGHT …`.
//!
//! Vertex numbers count the `v` lines of the OBJ from 0. Joint positions are absolute; rest rotations are the identity.

use super::text::{bad_line, lines, number, triple};
use super::{SceneError, load, orphans, weld, write_atomically};
use crate::rig::{Influence, Joint, Rig, Skeleton, Skin, Slot, Transform};
use crate::{Asset, Mesh};
use glam::{DAffine3, DVec3};
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

/// A parsed `rig.txt`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigText {
    /// Joint names and absolute positions [model unit], parents first.
    pub joints: Vec<(String, DVec3)>,
    /// Parent of each joint.
    pub parents: Vec<Option<usize>>,
    /// (joint, weight) pairs per raw OBJ vertex, as far as the file lists them.
    pub weights: Vec<Vec<(usize, f64)>>,
}

/// Reads a `rig.txt`.
///
/// # Errors
/// [`SceneError::Invalid`] with the line; [`SceneError::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<RigText, SceneError> {
    let path = path.as_ref();
    parse(&load(path)?).map_err(|e| e.in_file(path))
}

/// Vertex numbers beyond this are refused before memory is taken for them.
const MAX_VERTEX: usize = 1 << 24;

/// The same from bytes in memory.
///
/// # Errors
/// [`SceneError::Invalid`] with the line.
pub fn parse(bytes: &[u8]) -> Result<RigText, SceneError> {
    let text = lines(bytes);
    let mut joints: Vec<(String, DVec3)> = Vec::new();
    let mut index: HashMap<&str, usize> = HashMap::new();
    let (mut roots, mut edges, mut skin) = (Vec::new(), Vec::new(), Vec::new());
    for (i, line) in text.lines().enumerate() {
        let (at, mut words) = (i + 1, line.split_whitespace());
        match words.next() {
            None => {}
            Some("joints") => {
                let name = words.next().ok_or_else(|| bad_line(at, "a joint without a name"))?;
                let position = triple(&mut words, at)?;
                if !position.is_finite() {
                    return Err(bad_line(at, format!("joint {name} is not at a finite position")));
                }
                if index.insert(name, joints.len()).is_some() {
                    return Err(bad_line(at, format!("joint {name} is listed twice")));
                }
                joints.push((name.to_string(), position));
            }
            Some("root") => roots.push((at, words.next().unwrap_or(""))),
            Some("hier") => edges.push((at, words.next().unwrap_or(""), words.next().unwrap_or(""))),
            Some("skin") => skin.push((at, words)),
            Some(other) => return Err(bad_line(at, format!("{other:?} is none of joints, root, hier, skin"))),
        }
    }
    if joints.is_empty() {
        return Err(SceneError::invalid("", "the rig has no joints"));
    }
    let find = |at: usize, name: &str| {
        index.get(name).copied().ok_or_else(|| bad_line(at, format!("joint {name:?} is not defined")))
    };
    for (at, name) in roots {
        find(at, name)?;
    }
    let mut parents = vec![None; joints.len()];
    for (at, parent, child) in edges {
        let (p, c) = (find(at, parent)?, find(at, child)?);
        if parents[c].replace(p).is_some() {
            return Err(bad_line(at, format!("joint {child} has two parents")));
        }
    }
    let mut weights: Vec<Vec<(usize, f64)>> = Vec::new();
    for (at, mut words) in skin {
        let vertex = number(words.next(), at)?;
        if !(vertex >= 0.0 && vertex.fract() == 0.0 && vertex < MAX_VERTEX as f64) {
            return Err(bad_line(at, format!("{vertex} is not a vertex number")));
        }
        let vertex = vertex as usize;
        weights.resize(weights.len().max(vertex + 1), Vec::new());
        while let Some(name) = words.next() {
            let (joint, weight) = (find(at, name)?, number(words.next(), at)?);
            if !weight.is_finite() || weight < 0.0 {
                return Err(bad_line(at, format!("weight {weight} of joint {name}")));
            }
            weights[vertex].push((joint, weight));
        }
    }
    parents_first(RigText { joints, parents, weights })
}

fn parents_first(rig: RigText) -> Result<RigText, SceneError> {
    let n = rig.joints.len();
    let mut children = vec![Vec::new(); n];
    (0..n).for_each(|j| rig.parents[j].into_iter().for_each(|p: usize| children[p].push(j)));
    let mut stack: Vec<usize> = (0..n).rev().filter(|&j| rig.parents[j].is_none()).collect();
    let (mut order, mut place) = (Vec::with_capacity(n), vec![usize::MAX; n]);
    while let Some(j) = stack.pop() {
        place[j] = order.len();
        order.push(j);
        stack.extend(children[j].iter().rev());
    }
    if let Some(j) = place.iter().position(|&p| p == usize::MAX) {
        return Err(SceneError::invalid(
            "",
            format!("joint {} is its own ancestor: the hierarchy has a cycle", rig.joints[j].0),
        ));
    }
    let weights = rig.weights.into_iter().map(|l| l.into_iter().map(|(j, w)| (place[j], w)).collect()).collect();
    Ok(RigText {
        joints: order.iter().map(|&j| rig.joints[j].clone()).collect(),
        parents: order.iter().map(|&j| rig.parents[j].map(|p| place[p])).collect(),
        weights,
    })
}

/// Gives an asset this rig. `raw_vertex` maps the mesh's vertices to `v` lines of the OBJ.
///
/// # Errors
/// [`SceneError::Invalid`] if the rig lists vertices that the OBJ (of `raw_count` vertices) does not have.
pub fn apply(rig: &RigText, asset: &mut Asset, raw_vertex: &[u32], raw_count: usize) -> Result<(), SceneError> {
    if rig.weights.len() > raw_count {
        let what = format!(
            "it lists {} vertices, but the model has {raw_count}: it belongs to another model",
            rig.weights.len()
        );
        return Err(SceneError::invalid("", what));
    }
    let mut lists: Vec<Vec<Influence>> =
        raw_vertex.iter().map(|&v| normalized(rig.weights.get(v as usize).map_or(&[][..], Vec::as_slice))).collect();
    let unweighted = lists.iter().filter(|l| l.is_empty()).count();
    let Mesh { positions, .. } = &asset.mesh;
    if unweighted == lists.len() {
        asset.warnings.push("the rig gives no weights; everything hangs on its first joint".into());
        lists.iter_mut().for_each(|l| l.push(Influence { slot: 0, weight: 1.0 }));
    } else if unweighted > 0 {
        orphans::adopt(positions, &mut lists);
        asset.warnings.push(format!("{unweighted} vertices have no weight; each moves with its nearest neighbour"));
    }
    let skin = Skin {
        slots: (0..rig.joints.len())
            .map(|j| Slot { joint: j, inverse_bind: DAffine3::from_translation(-rig.joints[j].1) })
            .collect(),
        bind_positions: positions.clone(),
        influences: lists,
    };
    asset.rig = Rig { skeleton: skeleton(rig), skin };
    let (welded, welded_count) = weld::by_bind_and_influences(&asset.rig.skin);
    asset.mesh.welded = welded;
    asset.mesh.welded_count = welded_count;
    Ok(())
}

fn skeleton(rig: &RigText) -> Skeleton {
    let joint = |j: usize| {
        let (name, position) = &rig.joints[j];
        let origin = rig.parents[j].map_or(DVec3::ZERO, |p| rig.joints[p].1);
        let rest = Transform { translation: *position - origin, ..Transform::IDENTITY };
        Joint { name: name.clone(), parent: rig.parents[j], rest, node: None }
    };
    Skeleton { joints: (0..rig.joints.len()).map(joint).collect() }
}

/// Merged, normalised, largest first; empty if there is no weight.
fn normalized(pairs: &[(usize, f64)]) -> Vec<Influence> {
    let mut list: Vec<Influence> = Vec::new();
    for &(joint, weight) in pairs.iter().filter(|p| p.1 > 0.0) {
        match list.iter_mut().find(|i| i.slot as usize == joint) {
            Some(i) => i.weight += weight,
            None => list.push(Influence { slot: joint as u32, weight }),
        }
    }
    let sum: f64 = list.iter().map(|i| i.weight).sum();
    list.iter_mut().for_each(|i| i.weight /= sum);
    list.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.slot.cmp(&b.slot)));
    list
}

/// The rig of an asset as `rig.txt` writes it: rest positions of the joints, weights per vertex of the mesh.
pub fn from_asset(asset: &Asset) -> RigText {
    let skeleton = &asset.rig.skeleton;
    let world = skeleton.rest_world();
    let slots = &asset.rig.skin.slots;
    RigText {
        joints: skeleton
            .joints
            .iter()
            .zip(&world)
            .map(|(j, w)| (j.name.replace(char::is_whitespace, "_"), w.translation))
            .collect(),
        parents: skeleton.joints.iter().map(|j| j.parent).collect(),
        weights: asset
            .rig
            .skin
            .influences
            .iter()
            .map(|l| l.iter().map(|i| (slots[i.slot as usize].joint, i.weight)).collect())
            .collect(),
    }
}

/// The same rig with weights per raw OBJ vertex: `raw_vertex` maps the mesh's vertices to `v` lines. Those that no face uses get none.
pub fn per_raw_vertex(rig: &RigText, raw_vertex: &[u32], raw_count: usize) -> RigText {
    let mut weights = vec![Vec::new(); raw_count];
    raw_vertex.iter().zip(&rig.weights).for_each(|(&raw, list)| weights[raw as usize].clone_from(list));
    RigText { weights, ..rig.clone() }
}

/// Writes a `rig.txt`.
///
/// # Errors
/// [`SceneError::Io`].
pub fn write(path: impl AsRef<Path>, rig: &RigText) -> Result<(), SceneError> {
    write_atomically(path, |w| w.write_all(to_text(rig).as_bytes()))
}

/// The text of a `rig.txt`: numbers in the shortest form that reads back to the same bits.
pub fn to_text(rig: &RigText) -> String {
    let mut text = String::new();
    let mut line = |words: String| {
        text.push_str(&words);
        text.push('\n');
    };
    for (name, p) in &rig.joints {
        line(format!("joints {name} {} {} {}", p.x, p.y, p.z));
    }
    for (j, _) in rig.parents.iter().enumerate().filter(|(_, p)| p.is_none()) {
        line(format!("root {}", rig.joints[j].0));
    }
    for (v, list) in rig.weights.iter().enumerate() {
        let pairs: String = list.iter().map(|&(j, w)| format!(" {} {w}", rig.joints[j].0)).collect();
        line(format!("skin {v}{pairs}"));
    }
    for (j, p) in rig.parents.iter().enumerate() {
        p.iter().for_each(|&p| line(format!("hier {} {}", rig.joints[p].0, rig.joints[j].0)));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIG: &str =
        "joints tip 0 2 0\njoints base 0 1 0\nroot base\nskin 0 base 1.0\nskin 1 base 0.25 tip 0.75\nhier base tip\n";

    #[test]
    fn a_rig_is_put_parents_first_and_comes_back_from_its_own_text() {
        let rig = parse(RIG.as_bytes()).unwrap();
        assert_eq!(rig.joints[0].0, "base");
        assert_eq!(rig.parents, [None, Some(0)]);
        assert_eq!(rig.weights[1], [(0, 0.25), (1, 0.75)]);
        assert_eq!(parse(to_text(&rig).as_bytes()).unwrap(), rig);
    }

    #[test]
    fn cycles_unknown_joints_and_second_parents_are_refused_with_the_line() {
        for (text, part) in [
            ("joints a 0 0 0\njoints b 0 0 0\nhier a b\nhier b a\n", "cycle"),
            ("joints a 0 0 0\nroot a\nskin 0 c 1\n", "line 3"),
            ("joints a 0 0 0\njoints b 0 0 0\njoints c 0 0 0\nhier a c\nhier b c\n", "two parents"),
            ("joints a 0 nan 0\n", "finite"),
            ("skin 0\n", "no joints"),
        ] {
            let message = parse(text.as_bytes()).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}

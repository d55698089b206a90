//! Motions → glTF animations: one shared input per clip, only channels that move, continuous unit quaternions.
//!
//! What moves in one of several clips has a channel in all of them: where a player goes from clip to clip, nothing stays as the
//! clip before left it (Blender's actions, Unity's and Unreal's layers). So has what is shown elsewhere than where it is bound.

use super::ExportOptions;
use super::bin::{Output, Use, array, push};
use super::bound::away_from_bind;
use crate::rig::Transform;
use crate::{Asset, Motion};
use glam::{DQuat, DVec3};
use serde_json::{Value, json};

/// Differences from the node's own value that vanish in f32 are not motion (relative to the value's size).
const STILL: f64 = 1e-7;

/// Puts the motions before the document's own clips, which stay if they are to be kept.
pub(super) fn add(
    out: &mut Output,
    asset: &Asset,
    node_of_joint: &[usize],
    motions: &[Motion],
    options: &ExportOptions,
) {
    let mut old = if options.keep_clips { array(&mut out.json, "animations").clone() } else { Vec::new() };
    let mut names: Vec<String> = old.iter().filter_map(|a| a["name"].as_str().map(String::from)).collect();
    let mut animations = Vec::new();
    let away = away_from_bind(out, asset, node_of_joint);
    let keyed = |(j, [a, b, c]): (usize, &Moves)| {
        let [t, r, s] = moves_in_any(asset, j, motions);
        [t || *a, r || *b, s || *c]
    };
    let moved: Vec<Moves> = away.iter().enumerate().map(keyed).collect();
    for motion in motions {
        let name = unique(&motion.name, &mut names);
        animations.extend(animation(out, asset, node_of_joint, motion, &moved, &name));
    }
    let added: Vec<usize> = (0..node_of_joint.len()).filter(|&j| asset.rig.skeleton.joints[j].node.is_none()).collect();
    for (clip, motion) in old.iter_mut().zip(&options.kept) {
        channels(out, asset, node_of_joint, motion, &added, &away, clip);
    }
    animations.extend(old);
    out.json["animations"] = Value::Array(animations);
}

/// `name`, numbered if it is taken; the result is added to `names`.
pub(super) fn unique(name: &str, names: &mut Vec<String>) -> String {
    let free = |n: &String| !names.contains(n);
    let mut candidates = std::iter::once(name.to_string()).chain((1..).map(|k| format!("{name}_{k}")));
    let found = candidates.find(free).expect("the numbers do not end");
    names.push(found.clone());
    found
}

/// Times of a motion's frames [s].
pub(super) fn times(motion: &Motion) -> Vec<[f32; 1]> {
    (0..motion.poses.len()).map(|k| [(k as f64 / motion.fps) as f32]).collect()
}

/// Whether translation, rotation and scale of a joint move.
pub(super) type Moves = [bool; 3];

fn moves_in_any(asset: &Asset, j: usize, motions: &[Motion]) -> Moves {
    let rest = asset.rig.skeleton.joints[j].rest;
    motions.iter().fold([false; 3], |[t, r, s], motion| {
        let locals = || motion.poses.iter().map(|p| p.locals[j]);
        [
            t || moving(rest.translation, locals().map(|l| l.translation)).is_some(),
            r || turning(rest.rotation, locals().map(|l| l.rotation)).is_some(),
            s || moving(rest.scale, locals().map(|l| l.scale)).is_some(),
        ]
    })
}

/// Adds the channels of those of `joints` that move, here or as `moved` says of each joint, if it says anything; returns the accessor
/// of the times, if there were any.
fn channels(
    out: &mut Output,
    asset: &Asset,
    node_of_joint: &[usize],
    motion: &Motion,
    joints: &[usize],
    moved: &[Moves],
    animation: &mut Value,
) -> Option<usize> {
    let mut input = None;
    for &j in joints {
        let joint = &asset.rig.skeleton.joints[j];
        let locals: Vec<&Transform> = motion.poses.iter().map(|p| &p.locals[j]).collect();
        let [t, r, s] = moved.get(j).copied().unwrap_or_default();
        let still = |moves: bool, rest: DVec3| moves.then(|| vec![rest.as_vec3().to_array(); locals.len()]);
        let upright =
            |moves: bool| moves.then(|| vec![joint.rest.rotation.as_quat().normalize().to_array(); locals.len()]);
        let translations = moving(joint.rest.translation, locals.iter().map(|l| l.translation))
            .or_else(|| still(t, joint.rest.translation));
        let rotations = turning(joint.rest.rotation, locals.iter().map(|l| l.rotation)).or_else(|| upright(r));
        let scales = moving(joint.rest.scale, locals.iter().map(|l| l.scale)).or_else(|| still(s, joint.rest.scale));
        if translations.is_none() && rotations.is_none() && scales.is_none() {
            continue;
        }
        let node = node_of_joint[j];
        use_trs(&mut out.json["nodes"][node], &joint.rest);
        let input = *input.get_or_insert_with(|| out.floats(&times(motion), Use::Other, true));
        let outputs = [
            ("translation", translations.map(|v| out.floats(&v, Use::Other, false))),
            ("rotation", rotations.map(|v| out.floats(&v, Use::Other, false))),
            ("scale", scales.map(|v| out.floats(&v, Use::Other, false))),
        ];
        for (path, output) in outputs {
            let Some(output) = output else { continue };
            let sampler =
                push(animation, "samplers", json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
            push(animation, "channels", json!({ "sampler": sampler, "target": { "node": node, "path": path } }));
        }
    }
    input
}

fn animation(
    out: &mut Output,
    asset: &Asset,
    node_of_joint: &[usize],
    motion: &Motion,
    moved: &[Moves],
    name: &str,
) -> Option<Value> {
    let times = times(motion);
    let mut animation = json!({ "name": name, "channels": [], "samplers": [] });
    let all: Vec<usize> = (0..node_of_joint.len()).collect();
    let input = channels(out, asset, node_of_joint, motion, &all, moved, &mut animation);
    if input.is_none() {
        // An animation must have a channel: a motion that stands still holds its first joint.
        let rest = asset.rig.skeleton.joints.first()?.rest;
        let node = node_of_joint[0];
        use_trs(&mut out.json["nodes"][node], &rest);
        let held = vec![rest.translation.as_vec3().to_array(); times.len()];
        let (input, output) = (out.floats(&times, Use::Other, true), out.floats(&held, Use::Other, false));
        push(&mut animation, "samplers", json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
        push(&mut animation, "channels", json!({ "sampler": 0, "target": { "node": node, "path": "translation" } }));
    }
    Some(animation)
}

/// Animated nodes must not store a matrix.
fn use_trs(node: &mut Value, rest: &Transform) {
    let Some(object) = node.as_object_mut() else { return };
    if object.shift_remove("matrix").is_some() {
        object.insert("translation".into(), json!(rest.translation.to_array()));
        object.insert("rotation".into(), json!(rest.rotation.to_array()));
        object.insert("scale".into(), json!(rest.scale.to_array()));
    }
}

fn moving(rest: DVec3, values: impl Iterator<Item = DVec3>) -> Option<Vec<[f32; 3]>> {
    let size = STILL * rest.abs().max_element().max(f64::from(f32::MIN_POSITIVE));
    let values: Vec<DVec3> = values.collect();
    let still = values.iter().all(|v| (*v - rest).abs().max_element() <= size);
    (!still).then(|| values.iter().map(|v| v.as_vec3().to_array()).collect())
}

/// Unit quaternions, each on the side of the one before.
fn turning(rest: DQuat, values: impl Iterator<Item = DQuat>) -> Option<Vec<[f32; 4]>> {
    let mut last = rest;
    let values: Vec<DQuat> = values
        .map(|q| {
            let q = q.normalize();
            last = if q.dot(last) < 0.0 { -q } else { q };
            last
        })
        .collect();
    let still = values.iter().all(|q| (*q - rest).length() <= STILL);
    (!still).then(|| values.iter().map(|q| q.as_quat().normalize().to_array()).collect())
}

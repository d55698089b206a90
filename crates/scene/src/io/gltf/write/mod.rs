//! The GLB writer: the input's document patched, never rebuilt.
//!
//! What we do not interpret (extensions, extras, materials, cameras) stays, and so do the original buffers, byte for byte, as the head of the
//! binary chunk. A rig that came with the file keeps its nodes, bind matrices and weights; a rig that we made is attached as one joint tree, and
//! joints that we add to a given rig become nodes under its own.

mod animation;
mod bin;
mod helpers;
mod morph;
mod place;
mod rig;
mod scratch;

use crate::io::{SceneError, write_atomically};
use crate::{Asset, Motion, Source};
pub(super) use bin::{Output, Use};
pub use morph::Morphs;
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

/// What to write besides the motions.
#[derive(Clone, Debug)]
pub struct ExportOptions {
    /// Keep the clips that the input has (after the new ones).
    pub keep_clips: bool,
    /// Where the rig has joints that the document lacks: motions of the document's own clips, in their order, from which the keys of those
    /// joints are taken; the clips' own keys stay.
    pub kept: Vec<Motion>,
    /// Shapes that play with the motions.
    pub morphs: Option<Morphs>,
    /// Young's modulus of the flesh at the surface [Pa], per vertex, written as `_YOUNG`; none if empty.
    pub youngs: Vec<f32>,
    /// Goes to `asset.extras.animimic`: version, options, seed, metrics.
    pub extras: Value,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self { keep_clips: true, kept: Vec::new(), morphs: None, youngs: Vec::new(), extras: Value::Null }
    }
}

/// The GLB of an asset with some motions as clips.
///
/// # Errors
/// [`SceneError::Caller`] if a motion does not fit the asset's skeleton or is not finite, [`SceneError::Limit`] beyond 4 GiB.
pub fn write_clips(asset: &Asset, motions: &[Motion], options: &ExportOptions) -> Result<Vec<u8>, SceneError> {
    motions.iter().chain(&options.kept).try_for_each(|m| check(asset, m))?;
    let joints = &asset.rig.skeleton.joints;
    let ours = joints.iter().all(|j| j.node.is_none());
    let (mut out, parts) = match &asset.source {
        Source::Gltf { json, buffers } => (Output::patching(json.clone(), buffers), rig::parts_of(json, asset)?),
        Source::Plain => scratch::document(asset)?,
    };
    let node_of_joint = if ours {
        out.json["animations"] = json!([]);
        rig::attach(&mut out, asset, &parts)?
    } else {
        let moved = place::skinned_meshes_to_root(&mut out.json);
        let mut nodes: Vec<Option<usize>> =
            joints.iter().map(|j| j.node.map(|n| moved.get(&n).copied().unwrap_or(n))).collect();
        if nodes.contains(&None) {
            helpers::attach(&mut out, asset, &parts, &mut nodes)?;
        }
        nodes.into_iter().map(|n| n.unwrap_or(0)).collect()
    };
    if !options.youngs.is_empty() {
        add_youngs(&mut out, asset, &parts, &options.youngs)?;
    }
    animation::add(&mut out, asset, &node_of_joint, motions, options);
    if let Some(morphs) = &options.morphs {
        check_morphs(asset, motions, morphs)?;
        morph::add(&mut out, asset, &parts, motions, morphs)?;
    }
    if !options.extras.is_null() {
        if !out.json["asset"]["extras"].is_object() {
            out.json["asset"]["extras"] = json!({});
        }
        out.json["asset"]["extras"]["animimic"] = options.extras.clone();
    }
    out.glb()
}

/// Writes the GLB of an asset with some motions, whole or not at all.
///
/// # Errors
/// Those of [`write_clips`], and [`SceneError::Io`].
pub fn save_clips(
    path: impl AsRef<Path>,
    asset: &Asset,
    motions: &[Motion],
    options: &ExportOptions,
) -> Result<(), SceneError> {
    let bytes = write_clips(asset, motions, options)?;
    write_atomically(path, |w| w.write_all(&bytes))
}

/// Adds the attribute `_YOUNG` to every primitive.
fn add_youngs(out: &mut Output, asset: &Asset, parts: &[rig::PartPlace], youngs: &[f32]) -> Result<(), SceneError> {
    let vertices = asset.mesh.positions.len();
    if youngs.len() != vertices {
        return Err(SceneError::Caller(format!("{} moduli for {vertices} vertices", youngs.len())));
    }
    for part in parts {
        rig::own_mesh(out, part.node);
        let rows: Vec<[f32; 1]> = youngs[part.vertices.clone()].iter().map(|y| [*y]).collect();
        let accessor = out.floats(&rows, Use::Vertices, false);
        rig::primitive(&mut out.json, part)["attributes"]["_YOUNG"] = json!(accessor);
    }
    Ok(())
}

fn check_morphs(asset: &Asset, motions: &[Motion], morphs: &Morphs) -> Result<(), SceneError> {
    let (targets, vertices) = (morphs.names.len(), asset.mesh.positions.len());
    let frames = |(m, w): (&Motion, &Vec<Vec<f64>>)| m.poses.len() == w.len() && w.iter().all(|f| f.len() == targets);
    let fits = morphs.offsets.len() == targets
        && morphs.offsets.iter().all(|o| o.len() == vertices)
        && morphs.weights.len() == motions.len()
        && motions.iter().zip(&morphs.weights).all(frames);
    if fits { Ok(()) } else { Err(SceneError::Caller("the morphs do not fit the mesh and the motions".into())) }
}

fn check(asset: &Asset, motion: &Motion) -> Result<(), SceneError> {
    let joints = asset.rig.skeleton.joints.len();
    let problem = if motion.poses.is_empty() {
        Some("has no frames".to_string())
    } else if !(motion.fps > 0.0 && motion.fps.is_finite()) {
        Some(format!("has {} frames per second", motion.fps))
    } else if let Some(k) = motion.poses.iter().position(|p| p.locals.len() != joints) {
        Some(format!("has {} joints in frame {k}, the skeleton has {joints}", motion.poses[k].locals.len()))
    } else {
        let finite = |t: &crate::Transform| t.translation.is_finite() && t.rotation.is_finite() && t.scale.is_finite();
        motion.poses.iter().position(|p| !p.locals.iter().all(finite)).map(|k| format!("is not finite in frame {k}"))
    };
    problem.map_or(Ok(()), |what| Err(SceneError::Caller(format!("motion {:?} {what}", motion.name))))
}

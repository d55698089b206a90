//! glTF 2.0 (.glb, .gltf): our own checked layer over JSON.
//!
//! The displayed rest pose is x_v = Σ_k w_k · G(joint_k) · B_k · X_v (glTF 2.0 §3.7.3), rigid parts with their node as the only joint.

mod accessor;
pub mod clips;
mod container;
mod geometry;
mod json;
mod look;
mod meshopt;
mod nodes;
mod repair;
mod shape;
mod write;

pub use clips::{Clip, clips};
pub use write::{ExportOptions, Morphs, save_clips, write_clips};

use super::{Format, ReadOptions, SceneError};
use crate::rig::{Joint, Rig, Skeleton, Skin};
use crate::{Asset, Mesh, Source};
use accessor::Document;
use glam::{DAffine3, DMat3, DVec3};
use json::Place;
use nodes::Graph;
use std::path::Path;

pub(crate) const DRACO_ADVICE: &str = "Draco compression is not read; decompress with `npx @gltf-transform/cli copy INPUT.glb OUTPUT.glb` and use OUTPUT.glb";

/// Required extensions that are understood, or that do not touch the geometry (prefixes).
const EXTENSIONS: &[&str] = &[
    "KHR_mesh_quantization",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_materials_",
    "EXT_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_xmp",
    "KHR_animation_pointer",
];

/// The glTF 2.0 reader.
pub struct Gltf;

impl Format for Gltf {
    fn name(&self) -> &'static str {
        "gltf"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["glb", "gltf"]
    }

    fn summary(&self) -> &'static str {
        "glTF 2.0: meshes, skins, clips, textures; quantised, meshopt and WebP files too; written back as GLB"
    }

    fn recognises(&self, bytes: &[u8]) -> bool {
        container::recognises(bytes)
    }

    fn read(&self, bytes: Vec<u8>, path: &Path, options: &ReadOptions) -> Result<Asset, SceneError> {
        let mut loaded = container::open(bytes, path)?;
        check_extensions(&Place::root(&loaded.json))?;
        if options.repair {
            loaded = repair::mend(loaded)?;
        }
        let container::Loaded { json, buffers, mut warnings } = loaded;
        let (mesh, rig, looks) = interpret(&json, &buffers, &mut warnings)?;
        Ok(Asset { mesh, looks, rig, motions: Vec::new(), source: Source::Gltf { json, buffers }, warnings })
    }
}

fn interpret(
    json: &serde_json::Value,
    buffers: &[Vec<u8>],
    warnings: &mut Vec<String>,
) -> Result<(Mesh, Rig, Vec<crate::Look>), SceneError> {
    let document = Document::new(json, buffers)?;
    let graph = Graph::new(&document, warnings)?;
    let materials = look::materials(&document, warnings)?;
    let (mut mesh, mut skin, uses_default_look) = geometry::read(&document, &graph, &materials, warnings)?;
    let mut looks: Vec<crate::Look> = materials.into_iter().map(|m| m.look).collect();
    if uses_default_look {
        looks.push(crate::Look::default());
    }
    let skeleton = skeleton(&graph, &mut skin);
    let rig = Rig { skeleton, skin };
    pose_at_rest(&mut mesh, &rig);
    crate::io::check_extent(&mesh)?;
    let (welded, welded_count) = crate::io::weld::by_bind_and_influences(&rig.skin);
    mesh.welded = welded;
    mesh.welded_count = welded_count;
    Ok((mesh, rig, looks))
}

fn check_extensions(root: &Place) -> Result<(), SceneError> {
    for place in root.list("extensionsRequired")? {
        let name = place.value.as_str().unwrap_or("");
        if name == "KHR_draco_mesh_compression" {
            return Err(place.unsupported(DRACO_ADVICE));
        }
        if !EXTENSIONS.iter().any(|known| name.starts_with(known)) {
            let what = format!("the required extension {name:?} is not understood; export without it");
            return Err(place.unsupported(what));
        }
    }
    Ok(())
}

/// Joints are the nodes that slots refer to and their ancestors. Turns the slots' node indices into joint indices.
fn skeleton(graph: &Graph, skin: &mut Skin) -> Skeleton {
    let mut needed = vec![false; graph.nodes.len()];
    for slot in &skin.slots {
        let mut next = Some(slot.joint);
        while let Some(i) = next.filter(|&i| !needed[i]) {
            needed[i] = true;
            next = graph.nodes[i].parent;
        }
    }
    let mut joint_of = vec![usize::MAX; graph.nodes.len()];
    let mut joints = Vec::new();
    for &i in graph.order.iter().filter(|&&i| needed[i]) {
        let node = &graph.nodes[i];
        joint_of[i] = joints.len();
        let parent = node.parent.map(|p| joint_of[p]);
        joints.push(Joint { name: node.name.clone(), parent, rest: node.rest, node: Some(i) });
    }
    skin.slots.iter_mut().for_each(|s| s.joint = joint_of[s.joint]);
    Skeleton { joints }
}

/// Displayed positions and normals; triangles of mirrored parts are turned so that their front stays the front.
fn pose_at_rest(mesh: &mut Mesh, rig: &Rig) {
    let world = rig.skeleton.rest_world();
    mesh.positions = rig.skinned(&world);
    let slots: Vec<DAffine3> = rig.skin.slots.iter().map(|s| world[s.joint] * s.inverse_bind).collect();
    let blended = |v: usize| -> DMat3 {
        rig.skin.influences[v].iter().fold(DMat3::ZERO, |m, i| m + slots[i.slot as usize].matrix3 * i.weight)
    };
    for (v, normal) in mesh.normals.iter_mut().enumerate() {
        *normal = (cofactor(blended(v)) * *normal).normalize_or_zero();
    }
    for part in mesh.parts.clone() {
        let mirrored = part.vertices.clone().filter(|&v| blended(v).determinant() < 0.0).count();
        if 2 * mirrored > part.vertices.len() {
            mesh.triangles[part.triangles].iter_mut().for_each(|t| t.swap(1, 2));
        }
    }
}

/// det(m) · m⁻ᵀ: how area normals transform, also where m is singular; a mirror's sign is taken out again.
fn cofactor(m: DMat3) -> DMat3 {
    let (x, y, z): (DVec3, DVec3, DVec3) = (m.x_axis, m.y_axis, m.z_axis);
    let c = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
    if m.determinant() < 0.0 { c * -1.0 } else { c }
}

//! A document for an asset that has none: one mesh node with a primitive per part, materials, embedded textures.

use super::bin::{Output, Use, push};
use super::rig::PartPlace;
use crate::io::{SceneError, picture};
use crate::mesh::{AlphaMode, Look, Texture};
use crate::{Asset, Mesh};
use glam::DVec3;
use serde_json::{Value, json};

const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const WRAP_REPEAT: u32 = 10497;
const WRAP_CLAMP: u32 = 33071;
const NEAREST: u32 = 9728;
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;

/// The document, unskinned, and where each part is in it.
pub(super) fn document(asset: &Asset) -> Result<(Output, Vec<PartPlace>), SceneError> {
    let mut out = Output::empty();
    out.json["scene"] = json!(0);
    out.json["scenes"] = json!([{ "nodes": [0] }]);
    out.json["nodes"] = json!([{ "name": "mesh", "mesh": 0 }]);
    push(&mut out.json, "buffers", json!({}));
    for look in &asset.looks {
        let material = material(&mut out, look)?;
        push(&mut out.json, "materials", material);
    }
    let mut primitives = Vec::new();
    let mut parts = Vec::new();
    for (i, part) in asset.mesh.parts.iter().enumerate() {
        let place =
            PartPlace { node: 0, primitive: i, vertices: part.vertices.clone(), triangles: part.triangles.clone() };
        let mut primitive = primitive(&mut out, &asset.mesh, &place);
        if part.look < asset.looks.len() {
            primitive["material"] = json!(part.look);
        }
        primitives.push(primitive);
        parts.push(place);
    }
    out.json["meshes"] = json!([{ "name": "mesh", "primitives": primitives }]);
    Ok((out, parts))
}

fn primitive(out: &mut Output, mesh: &Mesh, part: &PartPlace) -> Value {
    let range = part.vertices.clone();
    let rows3 = |v: &[DVec3]| -> Vec<[f32; 3]> { v[range.clone()].iter().map(|p| p.as_vec3().to_array()).collect() };
    let mut attributes = json!({ "POSITION": out.floats(&rows3(&mesh.positions), Use::Vertices, true) });
    // Normals must be unit vectors: a part with missing ones leaves them to the viewer.
    if mesh.normals.len() >= range.end && mesh.normals[range.clone()].iter().all(|n| n.is_normalized()) {
        attributes["NORMAL"] = json!(out.floats(&rows3(&mesh.normals), Use::Vertices, false));
    }
    if mesh.uvs.len() >= range.end {
        let rows: Vec<[f32; 2]> = mesh.uvs[range.clone()].iter().map(|p| p.as_vec2().to_array()).collect();
        attributes["TEXCOORD_0"] = json!(out.floats(&rows, Use::Vertices, false));
    }
    if mesh.colors.len() >= range.end {
        attributes["COLOR_0"] = json!(out.floats(&mesh.colors[range.clone()], Use::Vertices, false));
    }
    let indices: Vec<u32> =
        mesh.triangles[part.triangles.clone()].iter().flatten().map(|i| i - range.start as u32).collect();
    let small = range.len() < usize::from(u16::MAX);
    let accessor = if small {
        let narrow: Vec<u16> = indices.iter().map(|&i| i as u16).collect();
        out.integers(bytemuck::cast_slice(&narrow), UNSIGNED_SHORT, "SCALAR", indices.len(), Use::Indices)
    } else {
        out.integers(bytemuck::cast_slice(&indices), UNSIGNED_INT, "SCALAR", indices.len(), Use::Indices)
    };
    json!({ "attributes": attributes, "indices": accessor })
}

fn material(out: &mut Output, look: &Look) -> Result<Value, SceneError> {
    let mut pbr = json!({
        "baseColorFactor": look.base_color, "metallicFactor": look.metallic, "roughnessFactor": look.roughness,
    });
    if let Some(texture) = &look.texture {
        pbr["baseColorTexture"] = json!({ "index": embed(out, texture)? });
    }
    let mut material = json!({ "name": look.name, "pbrMetallicRoughness": pbr });
    if look.emissive != [0.0; 3] {
        material["emissiveFactor"] = json!(look.emissive.map(|x| x.clamp(0.0, 1.0)));
    }
    match look.alpha {
        AlphaMode::Opaque => {}
        AlphaMode::Mask(cutoff) => {
            material["alphaMode"] = json!("MASK");
            material["alphaCutoff"] = json!(cutoff);
        }
        AlphaMode::Blend => material["alphaMode"] = json!("BLEND"),
    }
    if look.double_sided {
        material["doubleSided"] = json!(true);
    }
    if look.unlit {
        material["extensions"] = json!({ "KHR_materials_unlit": {} });
        let used = super::bin::array(&mut out.json, "extensionsUsed");
        if used.is_empty() {
            used.push(json!("KHR_materials_unlit"));
        }
    }
    Ok(material)
}

fn embed(out: &mut Output, texture: &Texture) -> Result<usize, SceneError> {
    let png = picture::encode_png(&texture.image, &texture.alpha)
        .map_err(|what| SceneError::Caller(format!("a texture cannot be written: {what}")))?;
    let view = out.view(&png, Use::Other);
    let image = push(&mut out.json, "images", json!({ "bufferView": view, "mimeType": "image/png" }));
    let wrap = texture.repeat.map(|r| if r { WRAP_REPEAT } else { WRAP_CLAMP });
    let (magnified, minified) = if texture.nearest { (NEAREST, NEAREST) } else { (LINEAR, LINEAR_MIPMAP_LINEAR) };
    let sampler = json!({ "wrapS": wrap[0], "wrapT": wrap[1], "magFilter": magnified, "minFilter": minified });
    let sampler = push(&mut out.json, "samplers", sampler);
    Ok(push(&mut out.json, "textures", json!({ "source": image, "sampler": sampler })))
}

//! Materials and textures.

use super::accessor::Document;
use super::container;
use super::json::Place;
use crate::io::{SceneError, picture};
use crate::mesh::{AlphaMode, Look, Texture};
use glam::{DAffine2, DVec2};

const WRAP_REPEAT: usize = 10497;
const WRAP_CLAMP: usize = 33071;
const FILTER_NEAREST: usize = 9728;

/// A material, and where its texture coordinates come from.
#[derive(Clone)]
pub(crate) struct Material {
    pub look: Look,
    /// `TEXCOORD_n` of the base colour texture.
    pub texcoord: usize,
    /// KHR_texture_transform, to be baked into the coordinates.
    pub uv_transform: DAffine2,
}

impl Default for Material {
    /// glTF's default material: white, fully metallic in the specification; drawn as plain white here.
    fn default() -> Self {
        Self { look: Look::default(), texcoord: 0, uv_transform: DAffine2::IDENTITY }
    }
}

/// All materials of the document. Textures that cannot be decoded are left out with a warning: their bytes still pass through.
pub(crate) fn materials(document: &Document, warnings: &mut Vec<String>) -> Result<Vec<Material>, SceneError> {
    let mut images = vec![None; document.root.len_of("images")];
    document.root.list("materials")?.iter().map(|m| material(document, m, &mut images, warnings)).collect()
}

type Decoded = Option<Option<(crate::Image, Vec<u8>)>>;

fn material(
    document: &Document,
    place: &Place,
    images: &mut [Decoded],
    warnings: &mut Vec<String>,
) -> Result<Material, SceneError> {
    let pbr = place.get("pbrMetallicRoughness");
    let number = |key: &str, default: f64| pbr.as_ref().map_or(Ok(default), |p| p.number_or(key, default));
    let base = pbr.as_ref().map_or(Ok([1.0; 4]), |p| p.numbers_or("baseColorFactor", [1.0; 4]))?;
    let strength = place
        .path(&["extensions", "KHR_materials_emissive_strength"])
        .map_or(Ok(1.0), |e| e.number_or("emissiveStrength", 1.0))?;
    let alpha = match place.text("alphaMode") {
        "MASK" => AlphaMode::Mask(place.number_or("alphaCutoff", 0.5)? as f32),
        "BLEND" => AlphaMode::Blend,
        _ => AlphaMode::Opaque,
    };
    let look = Look {
        name: place.text("name").to_string(),
        base_color: base.map(|x| x as f32),
        texture: None,
        emissive: place.numbers_or("emissiveFactor", [0.0; 3])?.map(|x| (x * strength) as f32),
        metallic: number("metallicFactor", 1.0)? as f32,
        roughness: number("roughnessFactor", 1.0)? as f32,
        alpha,
        double_sided: place.get("doubleSided").and_then(|d| d.value.as_bool()).unwrap_or(false),
        unlit: place.path(&["extensions", "KHR_materials_unlit"]).is_some(),
    };
    let mut material = Material { look, ..Material::default() };
    if let Some(info) = pbr.and_then(|p| p.get("baseColorTexture")) {
        material.texcoord = info.usize_or("texCoord", 0)?;
        if let Some(transform) = info.path(&["extensions", "KHR_texture_transform"]) {
            material.texcoord = transform.usize_or("texCoord", material.texcoord)?;
            material.uv_transform = uv_transform(&transform)?;
        }
        material.look.texture = texture(document, &info, images, warnings)?;
    }
    Ok(material)
}

/// KHR_texture_transform: translation · rotation · scale, with the extension's sense of rotation.
fn uv_transform(place: &Place) -> Result<DAffine2, SceneError> {
    let offset = DVec2::from(place.numbers_or("offset", [0.0; 2])?);
    let scale = DVec2::from(place.numbers_or("scale", [1.0; 2])?);
    let angle = place.number_or("rotation", 0.0)?;
    Ok(DAffine2::from_scale_angle_translation(scale, -angle, offset))
}

fn texture(
    document: &Document,
    info: &Place,
    images: &mut [Decoded],
    warnings: &mut Vec<String>,
) -> Result<Option<Texture>, SceneError> {
    let index = info.need("index")?;
    let texture = document.root.element("textures", index.usize()?, &index)?;
    let sampler = match texture.get("sampler") {
        Some(s) => Some(document.root.element("samplers", s.usize()?, &s)?),
        None => None,
    };
    let setting = |key: &str| sampler.as_ref().map_or(Ok(0), |s| s.usize_or(key, 0));
    let wrap = [setting("wrapS")?, setting("wrapT")?].map(|w| if w == 0 { WRAP_REPEAT } else { w });
    if wrap.iter().any(|&w| w != WRAP_REPEAT && w != WRAP_CLAMP) {
        warnings.push(format!("{} asks for mirrored wrapping; it is repeated plainly", texture.pointer));
    }
    let nearest = setting("magFilter")? == FILTER_NEAREST;
    // EXT_texture_webp is preferred where given: its presence says that WebP is the better copy.
    let source = texture.path(&["extensions", "EXT_texture_webp", "source"]).or_else(|| texture.get("source"));
    let Some(source) = source else {
        warnings.push(format!("texture left out: {} has no PNG, JPEG or WebP image", texture.pointer));
        return Ok(None);
    };
    let i = source.usize()?;
    let place = document.root.element("images", i, &source)?;
    if images[i].is_none() {
        images[i] = Some(match decode(document, &place) {
            Ok(decoded) => Some(decoded),
            Err(what) => {
                warnings.push(format!("texture left out: {} {what}", place.pointer));
                None
            }
        });
    }
    let Some(Some((image, alpha))) = images[i].clone() else { return Ok(None) };
    Ok(Some(Texture { image, alpha, repeat: wrap.map(|w| w != WRAP_CLAMP), nearest }))
}

fn decode(document: &Document, image: &Place) -> Result<(crate::Image, Vec<u8>), String> {
    if let Some(view) = image.get("bufferView") {
        let index = view.usize().map_err(|e| e.to_string())?;
        return picture::decode(document.view(index, &view).map_err(|e| e.to_string())?);
    }
    let uri = image.text("uri");
    if !uri.starts_with("data:") {
        return Err("could not be loaded".into());
    }
    picture::decode(&container::fetch(uri, std::path::Path::new(""))?)
}

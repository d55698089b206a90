//! The outer shell: GLB chunks, external buffers and images, data URIs. The result is JSON plus loaded buffers.

use super::accessor::MESHOPT;
use super::json::Place;
use crate::io::{SceneError, load};
use base64::Engine;
use serde_json::{Value, json};
use std::path::Path;

const GLB_MAGIC: &[u8; 4] = b"glTF";
const CHUNK_JSON: u32 = 0x4E4F_534A;
const CHUNK_BIN: u32 = 0x004E_4942;

/// JSON and buffers as they stood in the file(s). Buffers without data (meshopt fallbacks) are empty.
pub(crate) struct Loaded {
    pub json: Value,
    pub buffers: Vec<Vec<u8>>,
    pub warnings: Vec<String>,
}

/// Whether the bytes start like a GLB, or like JSON with an asset version.
pub(crate) fn recognises(bytes: &[u8]) -> bool {
    bytes.starts_with(GLB_MAGIC)
}

/// Splits a GLB or parses a .gltf, and loads everything it refers to.
pub(crate) fn open(bytes: Vec<u8>, path: &Path) -> Result<Loaded, SceneError> {
    let (mut json, bin) = if bytes.starts_with(GLB_MAGIC) { split_glb(&bytes)? } else { (parse(&bytes, 0)?, None) };
    if !json.is_object() {
        return Err(SceneError::invalid("", "the JSON is not an object"));
    }
    let version = json.pointer("/asset/version").and_then(Value::as_str).unwrap_or("");
    if !version.starts_with("2.") {
        let what = if version.is_empty() {
            "not a glTF 2.0 document: /asset/version is missing".to_string()
        } else {
            format!("glTF version {version:?} is not read; convert it to 2.0")
        };
        return Err(SceneError::invalid("", what));
    }
    super::shape::settle(&mut json)?;
    let mut loaded = Loaded { json, buffers: Vec::new(), warnings: Vec::new() };
    load_buffers(&mut loaded, bin, path)?;
    load_images(&mut loaded, path)?;
    Ok(loaded)
}

fn parse(bytes: &[u8], offset: usize) -> Result<Value, SceneError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(SceneError::invalid("", "the file is empty"));
    }
    serde_json::from_slice(bytes).map_err(|e| SceneError::invalid(format!("byte {offset}"), format!("not JSON: {e}")))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

/// glTF 2.0 §4.4: a 12-byte header, then chunks of length, kind, data.
fn split_glb(bytes: &[u8]) -> Result<(Value, Option<Vec<u8>>), SceneError> {
    let (Some(version), Some(length)) = (u32_at(bytes, 4), u32_at(bytes, 8)) else {
        return Err(SceneError::invalid("", format!("ends at byte {} of a 12-byte header", bytes.len())));
    };
    if version != 2 {
        return Err(SceneError::unsupported("", format!("GLB version {version}; only 2 is read")));
    }
    let length = length as usize;
    if length > bytes.len() {
        return Err(SceneError::invalid("", format!("ends at byte {} of {length}; it is truncated", bytes.len())));
    }
    let (mut at, mut json, mut bin) = (12usize, None, None);
    while at < length {
        let (Some(size), Some(kind)) = (u32_at(bytes, at), u32_at(bytes, at + 4)) else {
            return Err(SceneError::invalid(format!("byte {at}"), "a chunk header is cut off"));
        };
        let end = (at + 8).checked_add(size as usize).filter(|&e| e <= length);
        let Some(end) = end else {
            let what = format!("a chunk claims {size} bytes, but the file ends at byte {length}");
            return Err(SceneError::invalid(format!("byte {at}"), what));
        };
        let data = &bytes[at + 8..end];
        match kind {
            CHUNK_JSON if json.is_none() => json = Some(parse(data, at + 8)?),
            CHUNK_BIN if bin.is_none() => bin = Some(data.to_vec()),
            _ => {}
        }
        // Chunks should be padded to 4 bytes; some writers forget it on the last one.
        at = end;
    }
    Ok((json.ok_or_else(|| SceneError::invalid("", "the GLB has no JSON chunk"))?, bin))
}

fn load_buffers(loaded: &mut Loaded, mut bin: Option<Vec<u8>>, path: &Path) -> Result<(), SceneError> {
    let root = Place::root(&loaded.json);
    for (i, buffer) in root.list("buffers")?.iter().enumerate() {
        let length = buffer.need("byteLength")?.usize()?;
        let uri = buffer.text("uri");
        let data = if !uri.is_empty() {
            Some(fetch(uri, path).map_err(|what| buffer.invalid(what))?)
        } else if i == 0 && !is_fallback(buffer) {
            bin.take()
        } else {
            None
        };
        // A buffer of nothing is allowed; whoever refers into it is told that it is empty.
        let Some(mut data) = data else {
            loaded.buffers.push(Vec::new());
            continue;
        };
        if data.len() < length {
            return Err(buffer.invalid(format!("should hold {length} bytes, but only {} are there", data.len())));
        }
        data.truncate(length);
        loaded.buffers.push(data);
    }
    Ok(())
}

/// A buffer that only reserves room for decompressed meshopt data.
pub(crate) fn is_fallback(buffer: &Place) -> bool {
    let flag = |name: &str| buffer.path(&["extensions", name, "fallback"]).and_then(|f| f.value.as_bool());
    buffer.get("uri").is_none() && MESHOPT.iter().any(|name| flag(name) == Some(true))
}

/// External image files become buffers of their own, so that the document is complete in itself.
fn load_images(loaded: &mut Loaded, path: &Path) -> Result<(), SceneError> {
    let count = Place::root(&loaded.json).list("images")?.len();
    for i in 0..count {
        let uri = loaded.json["images"][i].get("uri").and_then(Value::as_str).unwrap_or("").to_string();
        if uri.is_empty() || uri.starts_with("data:") {
            continue;
        }
        let data = match fetch(&uri, path) {
            Ok(data) => data,
            Err(what) => {
                loaded.warnings.push(format!("texture left out: /images/{i} {what}"));
                continue;
            }
        };
        let Some(mime) = mime_of(&data) else {
            loaded.warnings.push(format!("texture left out: /images/{i} ({uri}) is neither PNG, JPEG nor WebP"));
            continue;
        };
        embed(loaded, i, data, mime);
    }
    Ok(())
}

fn embed(loaded: &mut Loaded, image: usize, data: Vec<u8>, mime: &str) {
    let json = &mut loaded.json;
    for key in ["buffers", "bufferViews"] {
        if !json[key].is_array() {
            json[key] = json!([]);
        }
    }
    let buffer = loaded.buffers.len();
    let view = json["bufferViews"].as_array().map_or(0, Vec::len);
    if let Some(buffers) = json["buffers"].as_array_mut() {
        buffers.push(json!({ "byteLength": data.len() }));
    }
    if let Some(views) = json["bufferViews"].as_array_mut() {
        views.push(json!({ "buffer": buffer, "byteLength": data.len() }));
    }
    if let Some(object) = json["images"][image].as_object_mut() {
        object.shift_remove("uri");
        object.insert("bufferView".into(), json!(view));
        object.insert("mimeType".into(), json!(mime));
    }
    loaded.buffers.push(data);
}

/// Media type by content.
pub(crate) fn mime_of(data: &[u8]) -> Option<&'static str> {
    if data.starts_with(b"\x89PNG") {
        Some("image/png")
    } else if data.starts_with(b"\xFF\xD8\xFF") {
        Some("image/jpeg")
    } else if data.len() > 12 && data.starts_with(b"RIFF") && &data[8..12] == b"WEBP" {
        Some("image/webp")
    } else {
        None
    }
}

/// The bytes behind a URI: a data URI, or a file below the document's folder.
pub(crate) fn fetch(uri: &str, document: &Path) -> Result<Vec<u8>, String> {
    if let Some(rest) = uri.strip_prefix("data:") {
        let (header, payload) = rest.split_once(',').ok_or("its data URI has no comma")?;
        if !header.ends_with(";base64") {
            return Ok(percent_decoded(payload));
        }
        let engine = base64::engine::general_purpose::STANDARD;
        return engine.decode(payload.trim()).map_err(|e| format!("its data URI is not base64: {e}"));
    }
    if uri.contains("://") {
        return Err(format!("{uri:?} is a network address; download it first"));
    }
    let relative = String::from_utf8_lossy(&percent_decoded(uri)).into_owned();
    let relative = Path::new(&relative);
    let inside =
        relative.components().all(|c| matches!(c, std::path::Component::Normal(_) | std::path::Component::CurDir));
    if !inside {
        return Err(format!("{uri:?} points outside the model's folder"));
    }
    let file = document.parent().unwrap_or(Path::new("")).join(relative);
    load(&file).map_err(|e| e.to_string())
}

fn percent_decoded(uri: &str) -> Vec<u8> {
    let bytes = uri.as_bytes();
    let (mut out, mut i) = (Vec::with_capacity(bytes.len()), 0);
    while i < bytes.len() {
        let hex =
            (bytes[i] == b'%').then(|| uri.get(i + 1..i + 3)).flatten().and_then(|h| u8::from_str_radix(h, 16).ok());
        out.push(hex.unwrap_or(bytes[i]));
        i += if hex.is_some() { 3 } else { 1 };
    }
    out
}

//! The document under construction: JSON and one growing binary chunk.

use crate::io::SceneError;
use crate::io::gltf::accessor::{Document, MESHOPT};
use serde_json::{Value, json};

const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// What a buffer view's data are for.
#[derive(Clone, Copy, PartialEq)]
pub(in crate::io::gltf) enum Use {
    Other,
    Vertices,
    Indices,
}

/// JSON and the binary chunk.
pub(in crate::io::gltf) struct Output {
    pub json: Value,
    bin: Vec<u8>,
}

/// The array under `key`, made if it is not there.
pub(super) fn array<'a>(object: &'a mut Value, key: &str) -> &'a mut Vec<Value> {
    if !object[key].is_array() {
        object[key] = json!([]);
    }
    object[key].as_array_mut().expect("an array was put there if there was none")
}

/// Appends to the array under `key` and returns the element's index.
pub(super) fn push(object: &mut Value, key: &str, element: Value) -> usize {
    let list = array(object, key);
    list.push(element);
    list.len() - 1
}

impl Output {
    /// An empty document.
    pub fn empty() -> Self {
        Self { json: json!({ "asset": { "version": "2.0", "generator": "animimic" } }), bin: Vec::new() }
    }

    /// Merges all buffers that have data into the binary chunk, the first at its very start; buffer views follow. Buffers without data
    /// (meshopt fallbacks) stay as they are, behind it.
    pub fn patching(mut json: Value, buffers: &[Vec<u8>]) -> Self {
        let mut bin: Vec<u8> = Vec::new();
        let (mut target, mut rest) = (Vec::new(), Vec::new());
        let old = array(&mut json, "buffers").clone();
        for (buffer, data) in old.iter().zip(buffers) {
            if data.is_empty() {
                rest.push(buffer.clone());
                target.push((rest.len(), 0));
            } else {
                bin.resize(bin.len().next_multiple_of(8), 0);
                target.push((0, bin.len()));
                bin.extend_from_slice(data);
            }
        }
        let mut main = old.first().cloned().filter(|_| !bin.is_empty()).unwrap_or_else(|| json!({}));
        if let Some(object) = main.as_object_mut() {
            object.shift_remove("uri");
        }
        json["buffers"] = Value::Array([vec![main], rest].concat());
        for view in array(&mut json, "bufferViews") {
            retarget(view, &target);
            for name in MESHOPT {
                if let Some(extension) = view.get_mut("extensions").and_then(|e| e.get_mut(name)) {
                    retarget(extension, &target);
                }
            }
        }
        Self { json, bin }
    }

    /// Adds bytes as a buffer view and returns its index.
    pub fn view(&mut self, data: &[u8], used: Use) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": data.len() });
        match used {
            Use::Other => {}
            Use::Vertices => view["target"] = json!(ARRAY_BUFFER),
            Use::Indices => view["target"] = json!(ELEMENT_ARRAY_BUFFER),
        }
        self.bin.extend_from_slice(data);
        push(&mut self.json, "bufferViews", view)
    }

    /// Adds rows of floats as an accessor with bounds where glTF asks for them, and returns its index.
    pub fn floats<const N: usize>(&mut self, rows: &[[f32; N]], used: Use, bounds: bool) -> usize {
        let view = self.view(bytemuck::cast_slice(rows.as_flattened()), used);
        let kind = match N {
            1 => "SCALAR",
            2 => "VEC2",
            3 => "VEC3",
            4 => "VEC4",
            _ => "MAT4",
        };
        let mut accessor = json!({ "bufferView": view, "componentType": FLOAT, "count": rows.len(), "type": kind });
        if bounds {
            let fold = |f: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..N).map(|c| rows.iter().map(|r| r[c]).reduce(f).unwrap_or(0.0)).collect()
            };
            accessor["min"] = json!(fold(f32::min));
            accessor["max"] = json!(fold(f32::max));
        }
        push(&mut self.json, "accessors", accessor)
    }

    /// What is there so far, to be read.
    pub fn document(&self) -> Document<'_> {
        Document::plain(&self.json, std::slice::from_ref(&self.bin))
    }

    /// Adds unsigned integers of `component` type, already as bytes.
    pub fn integers(&mut self, data: &[u8], component: u32, kind: &str, count: usize, used: Use) -> usize {
        let view = self.view(data, used);
        let accessor = json!({ "bufferView": view, "componentType": component, "count": count, "type": kind });
        push(&mut self.json, "accessors", accessor)
    }

    /// The document and its buffers, for reading on.
    pub fn into_parts(mut self) -> (Value, Vec<Vec<u8>>) {
        self.json["buffers"][0]["byteLength"] = json!(self.bin.len());
        let mut buffers = vec![Vec::new(); array(&mut self.json, "buffers").len()];
        buffers[0] = self.bin;
        (self.json, buffers)
    }

    /// The finished file (glTF 2.0 §4.4).
    pub fn glb(mut self) -> Result<Vec<u8>, SceneError> {
        if self.bin.is_empty() {
            let buffers = array(&mut self.json, "buffers");
            buffers.retain(|b| b.get("byteLength").is_some());
        } else {
            self.json["buffers"][0]["byteLength"] = json!(self.bin.len());
        }
        if let Some(root) = self.json.as_object_mut() {
            root.retain(|_, v| !v.as_array().is_some_and(Vec::is_empty));
        }
        let mut text = self.json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let chunk = |size: usize| if size == 0 { 0 } else { 8 + size };
        let total = 12 + chunk(text.len()) + chunk(self.bin.len());
        let total = u32::try_from(total).map_err(|_| SceneError::limit("", "a GLB holds at most 4 GiB"))?;
        let mut out = Vec::with_capacity(total as usize);
        out.extend_from_slice(b"glTF");
        out.extend([2, total].iter().flat_map(|n: &u32| n.to_le_bytes()));
        for (kind, data) in [(b"JSON", &text), (b"BIN\0", &self.bin)] {
            if !data.is_empty() {
                out.extend_from_slice(&(data.len() as u32).to_le_bytes());
                out.extend_from_slice(kind);
                out.extend_from_slice(data);
            }
        }
        Ok(out)
    }
}

fn retarget(view: &mut Value, target: &[(usize, usize)]) {
    // What names no buffer, or none that is there, stays as useless as it is.
    let index = view.get("buffer").and_then(Value::as_u64);
    let Some(&(buffer, shift)) = index.and_then(|i| target.get(i as usize)) else { return };
    view["buffer"] = json!(buffer);
    if shift > 0 {
        let offset = view.get("byteOffset").and_then(Value::as_u64).unwrap_or(0) as usize;
        view["byteOffset"] = json!(offset + shift);
    }
}

//! A small GLB with everything that is easily lost: transformed parents, a skin, a rigid part on a joint, seams, a clip, an unknown extension.
#![allow(dead_code, clippy::unwrap_used)]

use serde_json::{Value, json};

/// JSON and binary chunk of a GLB.
#[derive(Clone)]
pub struct Document {
    pub json: Value,
    pub bin: Vec<u8>,
}

impl Document {
    /// Appends floats and returns the accessor's index.
    pub fn floats(&mut self, kind: &str, width: usize, values: &[f32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        let mut accessor = json!({ "componentType": 5126, "type": kind, "count": values.len() / width });
        if kind == "VEC3" || kind == "SCALAR" {
            let fold = |f: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..width).map(|c| values.iter().skip(c).step_by(width).copied().reduce(f).unwrap()).collect()
            };
            accessor["min"] = json!(fold(f32::min));
            accessor["max"] = json!(fold(f32::max));
        }
        self.accessor(&bytes, accessor)
    }

    /// Appends bytes and returns the index of an accessor over them.
    pub fn accessor(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let views = self.json["bufferViews"].as_array_mut().unwrap();
        views.push(json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() }));
        accessor["bufferView"] = json!(views.len() - 1);
        self.bin.extend_from_slice(bytes);
        let accessors = self.json["accessors"].as_array_mut().unwrap();
        accessors.push(accessor);
        accessors.len() - 1
    }

    /// The file.
    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json["buffers"][0]["byteLength"].is_null() {
            json["buffers"] = json!([{ "byteLength": self.bin.len(), "name": "kept" }]);
        }
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut out = b"glTF".to_vec();
        for n in [2, (28 + text.len() + bin.len()) as u32, text.len() as u32] {
            out.extend(n.to_le_bytes());
        }
        out.extend(b"JSON");
        out.extend(text);
        out.extend((bin.len() as u32).to_le_bytes());
        out.extend(b"BIN\0");
        out.extend(bin);
        out
    }
}

/// A strip of two quads bending at a knee, and a triangle hung on the knee.
pub fn creature() -> Document {
    let mut d = Document {
        json: json!({
            "asset": { "version": "2.0", "generator": "fixture", "extras": { "artist": "kept" } },
            "extensionsUsed": ["VENDOR_unknown"],
            "accessors": [], "bufferViews": [],
            "scene": 0,
            "scenes": [{ "nodes": [0], "extras": { "mood": "kept" } }],
            "nodes": [
                { "name": "parent", "children": [1, 2], "translation": [1.0, 2.0, 3.0],
                  "rotation": [0.0, std::f64::consts::FRAC_1_SQRT_2, 0.0, std::f64::consts::FRAC_1_SQRT_2], "scale": [2.0, 2.0, 2.0] },
                { "name": "body", "mesh": 0, "skin": 0, "translation": [5.0, 0.0, 0.0], "extras": { "tag": "kept" } },
                { "name": "hip", "children": [3], "rotation": [0.0, 0.0, 0.1, 0.994_987_437_106_62] },
                { "name": "knee.L", "children": [4], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1, 0, 1] },
                { "name": "prop", "mesh": 1, "translation": [0.5, 0.25, 0.0] }
            ],
            "materials": [{ "name": "skin", "extensions": { "VENDOR_unknown": { "x": 1 } }, "doubleSided": true,
                "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.4, 0.2, 1.0] } }],
        }),
        bin: Vec::new(),
    };
    // The middle row is split by a seam: 8 vertices, 6 positions.
    let rows = [0.0f32, 1.0, 1.0, 2.0];
    let positions: Vec<f32> = rows.iter().flat_map(|&y| [0.0, y, 0.0, 1.0, y, 0.0]).collect();
    let uvs: Vec<f32> = rows.iter().enumerate().flat_map(|(i, _)| [0.0, i as f32 / 4.0, 1.0, i as f32 / 4.0]).collect();
    let knee = [0.0f32, 0.5, 0.5, 1.0];
    let weights: Vec<f32> = knee.iter().flat_map(|&k| [1.0 - k, k, 0.0, 0.0, 1.0 - k, k, 0.0, 0.0]).collect();
    let joints: Vec<u8> = (0..8).flat_map(|_| [0, 1, 0, 0]).collect();
    let indices: Vec<u8> = [0u16, 1, 2, 1, 3, 2, 4, 5, 6, 5, 7, 6].iter().flat_map(|i| i.to_le_bytes()).collect();
    let position = d.floats("VEC3", 3, &positions);
    let uv = d.floats("VEC2", 2, &uvs);
    let weight = d.floats("VEC4", 4, &weights);
    let joint = d.accessor(&joints, json!({ "componentType": 5121, "type": "VEC4", "count": 8 }));
    let index = d.accessor(&indices, json!({ "componentType": 5123, "type": "SCALAR", "count": 12 }));
    let mut binds = [0f32; 32];
    for k in 0..2 {
        (0..4).for_each(|i| binds[16 * k + 5 * i] = 1.0);
    }
    binds[16 + 13] = -1.0;
    let bind = d.floats("MAT4", 16, &binds);
    let triangle = d.floats("VEC3", 3, &[0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.3, 0.1]);
    let time = d.floats("SCALAR", 1, &[0.0, 0.5, 1.0]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let turn = d.floats("VEC4", 4, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, half, half, 0.0, 0.0, 1.0, 0.0]);
    let lift = d.floats("VEC3", 3, &[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    d.json["meshes"] = json!([
        { "name": "strip", "primitives": [{ "indices": index, "material": 0, "attributes":
            { "POSITION": position, "TEXCOORD_0": uv, "JOINTS_0": joint, "WEIGHTS_0": weight } }] },
        { "name": "prop", "primitives": [{ "attributes": { "POSITION": triangle } }] }
    ]);
    d.json["skins"] = json!([{ "joints": [2, 3], "inverseBindMatrices": bind }]);
    d.json["animations"] = json!([{ "name": "old", "samplers": [
            { "input": time, "output": turn, "interpolation": "LINEAR" }, { "input": time, "output": lift, "interpolation": "STEP" }],
        "channels": [{ "sampler": 0, "target": { "node": 2, "path": "rotation" } },
                     { "sampler": 1, "target": { "node": 2, "path": "translation" } }] }]);
    d
}

//! The shape of a document: which members are lists and objects, and what indices refer to. Checked once on reading, so that what patches the
//! document later need not ask again.

use crate::io::SceneError;
use serde_json::Value;
use std::collections::BTreeMap;

/// What a value must be like.
enum Shape {
    /// An object; of the named members, those that are there have shapes of their own.
    Object(&'static [(&'static str, Shape)]),
    /// An object all of whose members are alike.
    Map(&'static Shape),
    /// An array.
    List(&'static Shape),
    /// A non-negative integer; 3.0 is made 3.
    Whole,
    /// The index of an element of the document's list of that name.
    Index(&'static str),
    /// A string.
    Text,
}

use Shape::{Index, List, Map, Object, Text, Whole};

const ANY: Shape = Object(&[]);
const ACCESSOR: Shape = Index("accessors");
const BUFFER_VIEW: Shape = Index("bufferViews");
const NODE: Shape = Index("nodes");
const TEXTURE: Shape = Object(&[("index", Index("textures"))]);

const SPARSE: Shape =
    Object(&[("indices", Object(&[("bufferView", BUFFER_VIEW)])), ("values", Object(&[("bufferView", BUFFER_VIEW)]))]);
const ANIMATION: Shape = Object(&[
    ("channels", List(&Object(&[("sampler", Whole), ("target", Object(&[("node", NODE)]))]))),
    ("samplers", List(&Object(&[("input", ACCESSOR), ("output", ACCESSOR)]))),
]);
const MATERIAL: Shape = Object(&[
    ("pbrMetallicRoughness", Object(&[("baseColorTexture", TEXTURE), ("metallicRoughnessTexture", TEXTURE)])),
    ("normalTexture", TEXTURE),
    ("occlusionTexture", TEXTURE),
    ("emissiveTexture", TEXTURE),
]);
const PRIMITIVE: Shape = Object(&[
    ("attributes", Map(&ACCESSOR)),
    ("indices", ACCESSOR),
    ("material", Index("materials")),
    ("targets", List(&Map(&ACCESSOR))),
]);

/// The whole document.
const DOCUMENT: Shape = Object(&[
    ("asset", ANY),
    ("extensionsUsed", List(&Text)),
    ("extensionsRequired", List(&Text)),
    ("accessors", List(&Object(&[("bufferView", BUFFER_VIEW), ("sparse", SPARSE)]))),
    ("animations", List(&ANIMATION)),
    ("buffers", List(&Object(&[("byteLength", Whole), ("uri", Text)]))),
    (
        "bufferViews",
        List(&Object(&[
            ("buffer", Index("buffers")),
            ("byteOffset", Whole),
            ("byteLength", Whole),
            ("extensions", ANY),
        ])),
    ),
    ("cameras", List(&ANY)),
    ("images", List(&Object(&[("bufferView", BUFFER_VIEW), ("uri", Text)]))),
    ("materials", List(&MATERIAL)),
    ("meshes", List(&Object(&[("primitives", List(&PRIMITIVE))]))),
    (
        "nodes",
        List(&Object(&[
            ("children", List(&NODE)),
            ("mesh", Index("meshes")),
            ("skin", Index("skins")),
            ("camera", Index("cameras")),
        ])),
    ),
    ("samplers", List(&ANY)),
    ("scene", Index("scenes")),
    ("scenes", List(&Object(&[("nodes", List(&NODE))]))),
    ("skins", List(&Object(&[("joints", List(&NODE)), ("inverseBindMatrices", ACCESSOR), ("skeleton", NODE)]))),
    ("textures", List(&Object(&[("source", Index("images")), ("sampler", Index("samplers"))]))),
]);

/// How many elements the document's lists have.
type Counts = BTreeMap<String, u64>;

/// Checks a document and makes whole numbers of its indices.
///
/// # Errors
/// [`SceneError::Invalid`] with the JSON pointer of the first value that is of another kind, or of the first index that refers to nothing.
pub(super) fn settle(document: &mut Value) -> Result<(), SceneError> {
    let lists = document.as_object().into_iter().flatten();
    let counts = lists.filter_map(|(key, v)| Some((key.clone(), v.as_array()?.len() as u64))).collect();
    settle_as(&DOCUMENT, document, &counts, &mut String::new())?;
    document.get("animations").and_then(Value::as_array).into_iter().flatten().enumerate().try_for_each(samplers)
}

/// The samplers of an animation are its own.
fn samplers((index, animation): (usize, &Value)) -> Result<(), SceneError> {
    let list = |key: &str| animation.get(key).and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let count = list("samplers").len();
    for (c, channel) in list("channels").iter().enumerate() {
        if let Some(sampler) = channel.get("sampler").and_then(Value::as_u64).filter(|&s| s >= count as u64) {
            let pointer = format!("/animations/{index}/channels/{c}/sampler");
            let what = format!("refers to sampler {sampler}, but the animation has {count}");
            return Err(SceneError::invalid(pointer, what));
        }
    }
    Ok(())
}

fn settle_as(shape: &Shape, value: &mut Value, counts: &Counts, pointer: &mut String) -> Result<(), SceneError> {
    let what = match (shape, value) {
        (Object(members), Value::Object(object)) => {
            let mut known = members.iter();
            return known.try_for_each(|(key, shape)| {
                object.get_mut(*key).map_or(Ok(()), |v| inside(shape, key, v, counts, pointer))
            });
        }
        (Map(shape), Value::Object(object)) => {
            return object.iter_mut().try_for_each(|(key, v)| inside(shape, key, v, counts, pointer));
        }
        (List(shape), Value::Array(list)) => {
            return list.iter_mut().enumerate().try_for_each(|(k, v)| match v {
                Value::Null => Err(SceneError::invalid(format!("{pointer}/{k}"), "should not be null")),
                _ => inside(shape, &k, v, counts, pointer),
            });
        }
        (Whole | Index(_), value) => {
            // Some writers print integers as 3.0.
            if let Some(x) = value.as_f64().filter(|x| value.is_f64() && x.fract() == 0.0 && (0.0..9e15).contains(x)) {
                *value = (x as u64).into();
            }
            match (shape, value.as_u64()) {
                (_, None) => "should be a non-negative integer".to_owned(),
                (Index(list), Some(i)) => match counts.get(*list).copied().unwrap_or(0) {
                    n if i < n => return Ok(()),
                    n => format!("refers to {list} {i}, but the file has {n}"),
                },
                _ => return Ok(()),
            }
        }
        (Text, Value::String(_)) => return Ok(()),
        (Object(_) | Map(_), _) => "should be an object".into(),
        (List(_), _) => "should be an array".into(),
        (Text, _) => "should be a string".into(),
    };
    Err(SceneError::invalid(pointer.clone(), what))
}

/// The member of that name or number.
fn inside(
    shape: &Shape,
    key: &dyn std::fmt::Display,
    value: &mut Value,
    counts: &Counts,
    pointer: &mut String,
) -> Result<(), SceneError> {
    // A null member is an absent one.
    if value.is_null() {
        return Ok(());
    }
    let length = pointer.len();
    pointer.push_str(&format!("/{key}"));
    let settled = settle_as(shape, value, counts, pointer);
    pointer.truncate(length);
    settled
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn values_of_another_kind_are_named_by_their_pointer_and_whole_floats_become_integers() {
        let mut sound =
            json!({ "scene": 0.0, "scenes": [{}], "nodes": [{ "children": [1.0], "mesh": null }, {}], "extras": 7 });
        settle(&mut sound).unwrap();
        assert_eq!(sound["nodes"][0]["children"][0].as_u64(), Some(1));
        assert_eq!(sound["scene"].as_u64(), Some(0));
        for (document, words) in [
            (json!({ "nodes": [{}, { "children": [0, -1] }] }), "/nodes/1/children/1: should be a non-negative"),
            (
                json!({ "nodes": [{ "mesh": 1 }], "meshes": [{}] }),
                "/nodes/0/mesh: refers to meshes 1, but the file has 1",
            ),
            (
                json!({ "animations": [{ "channels": [{ "sampler": 0 }] }] }),
                "/animations/0/channels/0/sampler: refers to",
            ),
            (json!({ "nodes": {} }), "/nodes: should be an array"),
            (json!({ "nodes": [null] }), "/nodes/0: should not be null"),
            (json!({ "scenes": [3] }), "/scenes/0: should be an object"),
            (json!({ "meshes": [{ "primitives": [{ "attributes": { "A": [] } }] }] }), "attributes/A: should be a"),
            (json!({ "extensionsRequired": [2] }), "/extensionsRequired/0: should be a string"),
        ] {
            let said = settle(&mut document.clone()).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
    }
}

//! Primitives of shown mesh nodes → one mesh and its skin, in the order (node, primitive).

use super::accessor::{Document, Numbers};
use super::json::Place;
use super::look::Material;
use super::nodes::{Graph, affine_from_columns};
use crate::io::SceneError;
use crate::rig::{Influence, Skin, Slot};
use crate::{Mesh, Part};
use glam::{DAffine3, DVec2, DVec3};
use std::collections::BTreeMap;

/// Vertices and triangles of all parts together; the largest models sent in practice have a tenth of it.
const MAX_ELEMENTS: usize = 1 << 24;
/// Sums of weights that deviate by more than this are worth a warning (quantised weights deviate by less).
const WEIGHT_SUM_TOLERANCE: f64 = 0.01;
/// Sum of weights under which a vertex counts as unweighted.
const WEIGHT_SUM_MIN: f64 = 1e-6;

/// What the primitives add up to. Slots name *nodes* in place of joints until the skeleton is known.
pub(crate) struct Geometry<'a> {
    pub mesh: Mesh,
    pub skin: Skin,
    pub uses_default_look: bool,
    document: &'a Document<'a>,
    graph: &'a Graph<'a>,
    materials: &'a [Material],
    slot_of: BTreeMap<(usize, usize), u32>,
    warnings: Vec<String>,
}

/// (joint of the skin, weight) pairs per vertex.
type Weights = Vec<Vec<(usize, f64)>>;

/// Marks slots of rigid parts in `slot_of`.
const RIGID: usize = usize::MAX;

/// A skin's joints (node indices) and inverse bind matrices.
struct Binding {
    index: usize,
    joints: Vec<usize>,
    inverse_binds: Vec<DAffine3>,
}

/// Reads every shown mesh.
pub(crate) fn read<'a>(
    document: &'a Document<'a>,
    graph: &'a Graph<'a>,
    materials: &'a [Material],
    warnings: &mut Vec<String>,
) -> Result<(Mesh, Skin, bool), SceneError> {
    let mut geometry = Geometry {
        mesh: Mesh::default(),
        skin: Skin::default(),
        uses_default_look: false,
        document,
        graph,
        materials,
        slot_of: BTreeMap::new(),
        warnings: Vec::new(),
    };
    let mut hidden = 0;
    for (i, node) in graph.nodes.iter().enumerate() {
        let Some(mesh_index) = node.place.get("mesh") else { continue };
        if !node.shown {
            hidden += 1;
            continue;
        }
        let mesh = document.root.element("meshes", mesh_index.usize()?, &mesh_index)?;
        let binding = geometry.binding(&node.place)?;
        for primitive in mesh.list("primitives")? {
            geometry.primitive(i, &mesh, &primitive, binding.as_ref())?;
        }
    }
    if hidden > 0 {
        geometry.warnings.push(format!("{hidden} mesh nodes are not part of the default scene; they are left out"));
    }
    warnings.append(&mut geometry.warnings);
    Ok((geometry.mesh, geometry.skin, geometry.uses_default_look))
}

impl Geometry<'_> {
    fn binding(&mut self, node: &Place) -> Result<Option<Binding>, SceneError> {
        let Some(skin_index) = node.get("skin") else { return Ok(None) };
        let index = skin_index.usize()?;
        let skin = self.document.root.element("skins", index, &skin_index)?;
        let mut joints = Vec::new();
        for joint in skin.list("joints")? {
            let j = joint.usize()?;
            if j >= self.graph.nodes.len() {
                return Err(joint.invalid(format!("refers to node {j}, but the file has {}", self.graph.nodes.len())));
            }
            joints.push(j);
        }
        if joints.is_empty() {
            self.warnings.push(format!("{} has no joints; it is ignored and the part is rigid", skin.pointer));
            return Ok(None);
        }
        let mut inverse_binds = vec![DAffine3::IDENTITY; joints.len()];
        if let Some(accessor) = skin.get("inverseBindMatrices") {
            let matrices = self.document.numbers(&accessor)?;
            if matrices.width != 16 || matrices.count() < joints.len() {
                let what = format!("should hold {} 4×4 matrices, holds {}", joints.len(), matrices.count());
                return Err(accessor.invalid(what));
            }
            for (k, row) in matrices.rows().take(joints.len()).enumerate() {
                inverse_binds[k] = affine_from_columns(row)
                    .ok_or_else(|| accessor.invalid(format!("matrix {k} is not affine or not finite")))?;
            }
        }
        Ok(Some(Binding { index, joints, inverse_binds }))
    }

    fn slot(&mut self, key: (usize, usize), joint: usize, inverse_bind: DAffine3) -> u32 {
        let slots = &mut self.skin.slots;
        *self.slot_of.entry(key).or_insert_with(|| {
            slots.push(Slot { joint, inverse_bind });
            (slots.len() - 1) as u32
        })
    }

    fn primitive(
        &mut self,
        node: usize,
        mesh: &Place,
        primitive: &Place,
        binding: Option<&Binding>,
    ) -> Result<(), SceneError> {
        let mode = primitive.usize_or("mode", 4)?;
        if !is_drawn(primitive)? {
            let what = "has no positions or is made of points or lines; it is left out";
            self.warnings.push(format!("{} {what}", primitive.pointer));
            return Ok(());
        }
        if let Some(draco) = primitive.path(&["extensions", "KHR_draco_mesh_compression"]) {
            return Err(draco.unsupported(super::DRACO_ADVICE));
        }
        let attributes = primitive.need("attributes")?;
        let position = attributes.need("POSITION")?;
        let weights = self.graph.nodes[node].place.get("weights").or_else(|| mesh.get("weights"));
        let positions = positions(self.document, weights, primitive, &position)?;
        self.check_room(positions.len(), primitive)?;
        let count = positions.len();
        let triangles = triangles(self.document, primitive, mode, count)?;
        let first = self.mesh.positions.len();
        let look = self.look_index(primitive)?;
        self.add_surface(primitive, &attributes, count, look)?;
        self.add_influences(node, &attributes, &positions, binding)?;
        let first_triangle = self.mesh.triangles.len();
        self.mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| i + first as u32)));
        self.mesh.positions.resize(first + count, DVec3::ZERO);
        self.skin.bind_positions.extend(positions);
        self.mesh.parts.push(Part {
            name: self.graph.nodes[node].name.clone(),
            vertices: first..first + count,
            triangles: first_triangle..self.mesh.triangles.len(),
            look,
            skin: binding.map(|b| b.index),
        });
        Ok(())
    }

    fn check_room(&self, more: usize, place: &Place) -> Result<(), SceneError> {
        if self.mesh.positions.len().saturating_add(more) > MAX_ELEMENTS || self.mesh.triangles.len() > MAX_ELEMENTS {
            return Err(place.limit(format!("the model has more than {MAX_ELEMENTS} vertices or triangles")));
        }
        Ok(())
    }

    fn look_index(&mut self, primitive: &Place) -> Result<usize, SceneError> {
        let Some(material) = primitive.get("material") else {
            self.uses_default_look = true;
            return Ok(self.materials.len());
        };
        let index = material.usize()?;
        self.document.root.element("materials", index, &material)?;
        Ok(index)
    }

    /// Normals (as stored, posed later), texture coordinates and colours.
    fn add_surface(
        &mut self,
        primitive: &Place,
        attributes: &Place,
        count: usize,
        look: usize,
    ) -> Result<(), SceneError> {
        let first = self.mesh.positions.len();
        let default = Material::default();
        let material = self.materials.get(look).unwrap_or(&default);
        let read = |key: &str, width: std::ops::RangeInclusive<usize>| -> Result<Option<Numbers>, SceneError> {
            let Some(place) = attributes.get(key) else { return Ok(None) };
            let numbers = self.document.numbers(&place)?;
            if !width.contains(&numbers.width) || numbers.count() != count {
                let what =
                    format!("{key} has {} elements of {} numbers for {count} vertices", numbers.count(), numbers.width);
                return Err(primitive.invalid(what));
            }
            Ok(Some(numbers))
        };
        let normals = read("NORMAL", 3..=3)?;
        let uvs = read(&format!("TEXCOORD_{}", material.texcoord), 2..=2)?;
        let colors = read("COLOR_0", 3..=4)?;
        let youngs = read("_YOUNG", 1..=1)?;
        let mesh = &mut self.mesh;
        let fill = |x: f64| if x.is_finite() { x } else { 0.0 };
        append(&mut mesh.normals, first, count, DVec3::ZERO, normals, |r| {
            DVec3::new(fill(r[0]), fill(r[1]), fill(r[2]))
        });
        append(&mut mesh.uvs, first, count, DVec2::ZERO, uvs, |r| {
            material.uv_transform.transform_point2(DVec2::new(fill(r[0]), fill(r[1])))
        });
        append(&mut mesh.colors, first, count, [1.0; 3], colors, |r| {
            [r[0], r[1], r[2]].map(|x| fill(x).clamp(0.0, 1.0) as f32)
        });
        append(&mut mesh.youngs, first, count, 0.0, youngs, |r| fill(r[0]).max(0.0) as f32);
        Ok(())
    }

    fn add_influences(
        &mut self,
        node: usize,
        attributes: &Place,
        positions: &[DVec3],
        binding: Option<&Binding>,
    ) -> Result<(), SceneError> {
        let weighted = match binding {
            Some(binding) => self.weights(attributes, positions.len(), binding)?,
            None => None,
        };
        let (Some(binding), Some(mut influences)) = (binding, weighted) else {
            if binding.is_some() {
                self.warnings.push(format!("{} gives no weights; the part is rigid", attributes.pointer));
            }
            let slot = self.slot((RIGID, node), node, DAffine3::IDENTITY);
            self.skin
                .influences
                .resize(self.skin.influences.len() + positions.len(), vec![Influence { slot, weight: 1.0 }]);
            return Ok(());
        };
        let orphans = crate::io::orphans::adopt(positions, &mut influences);
        if orphans > 0 {
            let what = format!(
                "{orphans} vertices of {} have no weight; each moves with its nearest neighbour",
                attributes.pointer
            );
            self.warnings.push(what);
        }
        for vertex in influences {
            let mut list: Vec<Influence> = vertex
                .into_iter()
                .map(|(k, weight)| {
                    let slot = self.slot((binding.index, k), binding.joints[k], binding.inverse_binds[k]);
                    Influence { slot, weight }
                })
                .collect();
            list.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.slot.cmp(&b.slot)));
            self.skin.influences.push(list);
        }
        Ok(())
    }

    /// Normalised (joint of the skin, weight) pairs per vertex; `None` where no vertex has any weight.
    fn weights(&mut self, attributes: &Place, count: usize, binding: &Binding) -> Result<Option<Weights>, SceneError> {
        let mut pairs: Weights = vec![Vec::new(); count];
        let (mut bad, mut first_bad) = (0usize, None);
        for set in 0.. {
            let (Some(joints), Some(weights)) =
                (attributes.get(&format!("JOINTS_{set}")), attributes.get(&format!("WEIGHTS_{set}")))
            else {
                break;
            };
            let (j, w) = (self.document.numbers(&joints)?, self.document.numbers(&weights)?);
            if j.width != 4 || w.width != 4 || j.count() != count || w.count() != count {
                return Err(joints.invalid(format!("joints and weights should be 4 for each of {count} vertices")));
            }
            for (v, (joints, weights)) in j.rows().zip(w.rows()).enumerate() {
                for (&joint, &weight) in joints.iter().zip(weights) {
                    if weight > 0.0 && weight.is_finite() && (joint as usize) < binding.joints.len() {
                        push(&mut pairs[v], joint as usize, weight);
                    } else if weight > 0.0 || weight.is_nan() {
                        bad += 1;
                        first_bad.get_or_insert((v, joint, weight));
                    }
                }
            }
        }
        if let Some((v, joint, weight)) = first_bad {
            let what = format!(
                "{bad} influences are unusable, the first is joint {joint} with weight {weight} of vertex {v} (the skin has {} joints)",
                binding.joints.len()
            );
            return Err(attributes.invalid(format!("{what}; use --repair to drop them")));
        }
        let mut uneven = 0;
        for list in &mut pairs {
            let sum: f64 = list.iter().map(|p| p.1).sum();
            if sum < WEIGHT_SUM_MIN {
                list.clear();
                continue;
            }
            uneven += usize::from((sum - 1.0).abs() > WEIGHT_SUM_TOLERANCE);
            list.iter_mut().for_each(|p| p.1 /= sum);
        }
        if uneven > 0 {
            self.warnings.push(format!(
                "{uneven} vertices of {} had weights that do not sum to 1; normalised",
                attributes.pointer
            ));
        }
        Ok(pairs.iter().any(|l| !l.is_empty()).then_some(pairs))
    }
}

/// Stored positions with the default morph weights applied.
pub(super) fn positions(
    document: &Document,
    weights: Option<Place>,
    primitive: &Place,
    position: &Place,
) -> Result<Vec<DVec3>, SceneError> {
    let mut positions = vec3s(document, position)?;
    if let Some(weights) = weights {
        for (target, weight) in primitive.list("targets")?.iter().zip(weights.items()?) {
            let weight = weight.number()?;
            let Some(offset) = target.get("POSITION").filter(|_| weight != 0.0) else { continue };
            let offsets = vec3s(document, &offset)?;
            if offsets.len() != positions.len() {
                return Err(offset.invalid("a morph target has another number of vertices than its mesh"));
            }
            positions.iter_mut().zip(offsets).for_each(|(p, d)| *p += d * weight);
        }
    }
    let bad = positions.iter().filter(|p| !p.is_finite()).count();
    if let Some(at) = positions.iter().position(|p| !p.is_finite()) {
        let what = format!("{bad} vertices are not finite, the first is {at}; use --repair to drop them");
        return Err(position.invalid(what));
    }
    Ok(positions)
}

/// The triangles of a primitive, all of them within its `count` vertices.
fn triangles(document: &Document, primitive: &Place, mode: usize, count: usize) -> Result<Vec<[u32; 3]>, SceneError> {
    let Some(accessor) = primitive.get("indices") else {
        let all: Vec<u32> = (0..count as u32).collect();
        return Ok(expand(mode, &all));
    };
    let indices = document.indices(&accessor)?;
    let bad = indices.iter().filter(|&&i| i as usize >= count).count();
    if let Some(at) = indices.iter().position(|&i| i as usize >= count) {
        return Err(accessor.invalid(format!(
            "{bad} indices are out of range, the first is {} at {at} ({count} vertices); use --repair to drop their triangles",
            indices[at]
        )));
    }
    Ok(expand(mode, &indices))
}

/// Whether a primitive becomes a part of the mesh: glTF allows those without positions, and points and lines enclose nothing.
pub(super) fn is_drawn(primitive: &Place) -> Result<bool, SceneError> {
    Ok((4..=6).contains(&primitive.usize_or("mode", 4)?) && primitive.need("attributes")?.get("POSITION").is_some())
}

/// Triangle lists (4), strips (5, every other one turned) and fans (6) as lists.
pub(super) fn expand(mode: usize, indices: &[u32]) -> Vec<[u32; 3]> {
    let turned = |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] };
    match mode {
        5 => indices.windows(3).enumerate().map(turned).collect(),
        6 => indices.windows(2).skip(1).map(|w| [indices[0], w[0], w[1]]).collect(),
        _ => indices.as_chunks::<3>().0.to_vec(),
    }
}

/// Adds a weight, joining it with an earlier one of the same joint.
fn push(list: &mut Vec<(usize, f64)>, joint: usize, weight: f64) {
    match list.iter_mut().find(|(j, _)| *j == joint) {
        Some(pair) => pair.1 += weight,
        None => list.push((joint, weight)),
    }
}

/// Extends an optional vertex attribute: it stays empty until a first part has it, then parts without it get `default`.
fn append<T: Copy>(
    out: &mut Vec<T>,
    first: usize,
    count: usize,
    default: T,
    numbers: Option<Numbers>,
    convert: impl Fn(&[f64]) -> T,
) {
    match numbers {
        Some(numbers) => {
            out.resize(first, default);
            out.extend(numbers.rows().map(convert));
        }
        None if !out.is_empty() => out.resize(first + count, default),
        None => {}
    }
}

fn vec3s(document: &Document, place: &Place) -> Result<Vec<DVec3>, SceneError> {
    let numbers = document.numbers(place)?;
    if numbers.width != 3 {
        return Err(place.invalid("positions should be VEC3"));
    }
    Ok(numbers.rows().map(DVec3::from_slice).collect())
}

//! The node hierarchy: checked to be a forest, walked without recursion.

use super::accessor::Document;
use super::json::Place;
use crate::Transform;
use crate::io::SceneError;
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};

/// Entries of a matrix may differ by this much, relative to the largest, from the TRS it is decomposed to.
const MATRIX_TOLERANCE: f64 = 1e-5;

/// A node, checked.
pub(crate) struct Node<'a> {
    pub place: Place<'a>,
    pub name: String,
    pub parent: Option<usize>,
    pub children: Vec<usize>,
    pub rest: Transform,
    /// Whether the default scene shows it.
    pub shown: bool,
}

/// All nodes and a parents-first order of them (depth first, children in file order).
pub(crate) struct Graph<'a> {
    pub nodes: Vec<Node<'a>>,
    pub order: Vec<usize>,
}

impl<'a> Graph<'a> {
    /// Reads all nodes.
    pub fn new(document: &Document<'a>, warnings: &mut Vec<String>) -> Result<Self, SceneError> {
        let places = document.root.list("nodes")?;
        let mut nodes = Vec::with_capacity(places.len());
        for (i, place) in places.into_iter().enumerate() {
            let name = match place.text("name") {
                "" => format!("node_{i}"),
                name => name.to_string(),
            };
            let rest = local_transform(&place, warnings)?;
            nodes.push(Node { place, name, parent: None, children: Vec::new(), rest, shown: false });
        }
        link(&mut nodes)?;
        let order = parents_first(&nodes)?;
        show(document, &mut nodes, &order)?;
        Ok(Self { nodes, order })
    }
}

fn link(nodes: &mut [Node]) -> Result<(), SceneError> {
    for i in 0..nodes.len() {
        for child in nodes[i].place.list("children")? {
            let c = child.usize()?;
            if c >= nodes.len() {
                return Err(child.invalid(format!("refers to node {c}, but the file has {}", nodes.len())));
            }
            if let Some(other) = nodes[c].parent {
                return Err(child.invalid(format!("node {c} already has the parent {other}; a node has one parent")));
            }
            nodes[c].parent = Some(i);
            nodes[i].children.push(c);
        }
    }
    Ok(())
}

fn parents_first(nodes: &[Node]) -> Result<Vec<usize>, SceneError> {
    let mut order = Vec::with_capacity(nodes.len());
    let mut stack: Vec<usize> = (0..nodes.len()).rev().filter(|&i| nodes[i].parent.is_none()).collect();
    while let Some(i) = stack.pop() {
        order.push(i);
        stack.extend(nodes[i].children.iter().rev());
    }
    if order.len() == nodes.len() {
        return Ok(order);
    }
    // Every node has at most one parent, so whatever no root reaches hangs on a cycle.
    let mut reached = vec![false; nodes.len()];
    order.iter().for_each(|&i| reached[i] = true);
    let first = reached.iter().position(|r| !r).unwrap_or(0);
    Err(nodes[first].place.invalid("this node is its own ancestor: the hierarchy has a cycle"))
}

/// Marks what the default scene (or the first, or without scenes every root) shows.
fn show(document: &Document, nodes: &mut [Node], order: &[usize]) -> Result<(), SceneError> {
    let scenes = document.root.len_of("scenes");
    if scenes == 0 {
        nodes.iter_mut().for_each(|n| n.shown = true);
        return Ok(());
    }
    let index = document.root.usize_or("scene", 0)?;
    let scene = document.root.element("scenes", index, &document.root)?;
    for root in scene.list("nodes")? {
        let r = root.usize()?;
        let count = nodes.len();
        let node =
            nodes.get_mut(r).ok_or_else(|| root.invalid(format!("refers to node {r}, but the file has {count}")))?;
        node.shown = true;
    }
    for &i in order {
        if nodes[i].parent.is_some_and(|p| nodes[p].shown) {
            nodes[i].shown = true;
        }
    }
    Ok(())
}

/// `translation`, `rotation`, `scale`, or the decomposed `matrix`.
fn local_transform(place: &Place, warnings: &mut Vec<String>) -> Result<Transform, SceneError> {
    if place.get("matrix").is_some() {
        let identity = DMat4::IDENTITY.to_cols_array();
        let matrix = place.numbers_or("matrix", identity)?;
        let affine = affine_from_columns(&matrix).ok_or_else(|| place.invalid("its matrix is not affine"))?;
        let trs = decompose(affine);
        let scale = affine.matrix3.to_cols_array().iter().fold(0.0f64, |m, x| m.max(x.abs()));
        let error = (trs.affine().matrix3 - affine.matrix3).to_cols_array().iter().fold(0.0f64, |m, x| m.max(x.abs()));
        if error > MATRIX_TOLERANCE * scale {
            warnings.push(format!("{}/matrix is sheared; the shear is lost", place.pointer));
        }
        return Ok(trs);
    }
    let [x, y, z, w] = place.numbers_or("rotation", [0.0, 0.0, 0.0, 1.0])?;
    let q = DQuat::from_xyzw(x, y, z, w);
    if q.length() < 1e-6 {
        warnings.push(format!("{}/rotation is zero; taken as no rotation", place.pointer));
    }
    Ok(Transform {
        translation: DVec3::from(place.numbers_or("translation", [0.0; 3])?),
        rotation: if q.length() < 1e-6 { DQuat::IDENTITY } else { q.normalize() },
        scale: DVec3::from(place.numbers_or("scale", [1.0; 3])?),
    })
}

/// A column-major 4×4 matrix as an affine map; `None` if its last row is not (0, 0, 0, 1).
pub(crate) fn affine_from_columns(m: &[f64]) -> Option<DAffine3> {
    let m = DMat4::from_cols_slice(m.get(..16)?);
    let last = m.row(3);
    let affine = (last - glam::DVec4::W).abs().max_element() < 1e-4 && m.is_finite();
    affine.then(|| DAffine3::from_mat4(m))
}

/// T · R · S of an affine map, also where an axis is squashed to nothing.
pub(crate) fn decompose(a: DAffine3) -> Transform {
    let scale = DVec3::new(a.matrix3.x_axis.length(), a.matrix3.y_axis.length(), a.matrix3.z_axis.length());
    if scale.min_element() > 1e-12 * scale.max_element() && scale.max_element() > 0.0 {
        return Transform::from_affine(a);
    }
    let rotation = DQuat::from_mat3(&completed_axes(a.matrix3)).normalize();
    Transform { translation: a.translation, rotation, scale }
}

/// A rotation whose axes are those of `m` where they exist.
fn completed_axes(m: DMat3) -> DMat3 {
    let axis = |v: DVec3| v.try_normalize();
    let (x, y, z) = match (axis(m.x_axis), axis(m.y_axis), axis(m.z_axis)) {
        (Some(x), Some(y), _) => (x, y, x.cross(y)),
        (Some(x), None, Some(z)) => (x, z.cross(x), z),
        (None, Some(y), Some(z)) => (y.cross(z), y, z),
        (Some(x), None, None) => (x, x.any_orthonormal_vector(), x.cross(x.any_orthonormal_vector())),
        (None, Some(y), None) => (y.any_orthonormal_vector(), y, y.any_orthonormal_vector().cross(y)),
        (None, None, Some(z)) => (z.any_orthonormal_vector(), z.cross(z.any_orthonormal_vector()), z),
        (None, None, None) => (DVec3::X, DVec3::Y, DVec3::Z),
    };
    DMat3::from_cols(x, y, z)
}

//! Blended primitives: distance, normal, and skin weights from closeness.
//!
//! Primitives of the whole body are joined by the exponential smooth minimum d = −k·ln Σ exp(−dᵢ/k) (Quílez), which does not
//! depend on their order. The weight of a joint is ∝ Σ exp(−dᵢ/τ) over its primitives: 1 deep in a limb, shared where
//! two primitives overlap, which is where the limb bends.

use super::surface_net::Surface;
use animimic_scene::{Influence, Skeleton, Skin, Slot};
use glam::{DAffine3, DVec3};

/// Width of the blend between primitives [m].
const BLEND: f64 = 0.022;
/// Width of the transition between joints' weights [m].
const TRANSITION: f64 = 0.018;
/// Rounds of averaging weights over neighbouring vertices.
const SMOOTHING_ROUNDS: usize = 4;
/// Influences per vertex, what every engine reads.
const INFLUENCES: usize = 4;

/// A piece of body that follows one joint.
pub struct Primitive {
    /// Index of the joint.
    pub joint: usize,
    /// Its form.
    pub shape: Shape,
}

/// Forms with a distance function.
pub enum Shape {
    /// A cone from `a` to `b` with round ends of two radii, optionally flattened along a unit direction by a factor.
    Cone { a: DVec3, b: DVec3, radii: [f64; 2], flatten: Option<(DVec3, f64)> },
    /// An ellipsoid along the axes.
    Ellipsoid { center: DVec3, radii: DVec3 },
}

impl Shape {
    fn distance(&self, p: DVec3) -> f64 {
        match *self {
            Shape::Cone { a, b, radii, flatten } => {
                let (p, shrink) = match flatten {
                    Some((n, f)) => (p + n * (n.dot(p - a) * (1.0 / f - 1.0)), f),
                    None => (p, 1.0),
                };
                let axis = b - a;
                let t = ((p - a).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
                ((p - a - axis * t).length() - (radii[0] + (radii[1] - radii[0]) * t)) * shrink.sqrt()
            }
            // First-order distance of an ellipsoid: (k₀ − 1)·k₀ / k₁ (Quílez).
            Shape::Ellipsoid { center, radii } => {
                let (k0, k1) = (((p - center) / radii).length(), ((p - center) / (radii * radii)).length());
                if k1 == 0.0 { -radii.min_element() } else { k0 * (k0 - 1.0) / k1 }
            }
        }
    }
}

/// Signed distance to the blended body, negative inside.
pub fn distance(primitives: &[Primitive], p: DVec3) -> f64 {
    let each: Vec<f64> = primitives.iter().map(|q| q.shape.distance(p)).collect();
    let least = each.iter().copied().fold(f64::INFINITY, f64::min);
    least - BLEND * each.iter().map(|d| (-(d - least) / BLEND).exp()).sum::<f64>().ln()
}

/// Outward unit normal by central differences.
pub fn normal(primitives: &[Primitive], p: DVec3) -> DVec3 {
    const H: f64 = 1e-4;
    let d = |axis: DVec3| distance(primitives, p + axis * H) - distance(primitives, p - axis * H);
    DVec3::new(d(DVec3::X), d(DVec3::Y), d(DVec3::Z)).normalize()
}

/// Weights \[vertex\]\[joint\], rows summing to 1.
pub fn weights(primitives: &[Primitive], surface: &Surface, joints: usize) -> Vec<Vec<f64>> {
    let mut w: Vec<Vec<f64>> = surface.positions.iter().map(|p| closeness(primitives, *p, joints)).collect();
    let neighbours = surface.neighbours();
    for _ in 0..SMOOTHING_ROUNDS {
        w = (0..w.len())
            .map(|v| {
                let around = &neighbours[v];
                (0..joints)
                    .map(|j| {
                        0.5 * w[v][j]
                            + 0.5 * around.iter().map(|&u| w[u as usize][j]).sum::<f64>() / around.len() as f64
                    })
                    .collect()
            })
            .collect();
    }
    w
}

fn closeness(primitives: &[Primitive], p: DVec3, joints: usize) -> Vec<f64> {
    let each: Vec<f64> = primitives.iter().map(|q| q.shape.distance(p)).collect();
    let least = each.iter().copied().fold(f64::INFINITY, f64::min);
    let mut row = vec![0.0; joints];
    for (q, d) in primitives.iter().zip(&each) {
        row[q.joint] += (-(d - least) / TRANSITION).exp();
    }
    let sum: f64 = row.iter().sum();
    row.iter().map(|x| x / sum).collect()
}

/// The skin of the unwrapped vertices: the four largest weights of each vertex's source, one slot per joint.
pub fn skin(skeleton: &Skeleton, positions: &[DVec3], source_vertex: &[u32], weights: &[Vec<f64>]) -> Skin {
    let world = skeleton.rest_world();
    let slots = world.iter().enumerate().map(|(joint, w)| Slot { joint, inverse_bind: DAffine3::inverse(w) }).collect();
    let influences = source_vertex.iter().map(|&v| largest(&weights[v as usize])).collect();
    Skin { slots, bind_positions: positions.to_vec(), influences }
}

fn largest(row: &[f64]) -> Vec<Influence> {
    /// Weights below this move nothing that can be seen.
    const LEAST: f64 = 0.004;
    let mut order: Vec<usize> = (0..row.len()).filter(|&j| row[j] > LEAST).collect();
    order.sort_by(|&a, &b| row[b].total_cmp(&row[a]).then(a.cmp(&b)));
    order.truncate(INFLUENCES);
    let sum: f64 = order.iter().map(|&j| row[j]).sum();
    order.iter().map(|&j| Influence { slot: j as u32, weight: row[j] / sum }).collect()
}

//! Bones: segments from a joint to the joints below it, with the thickness of the flesh around them.
//!
//! A joint without joints below it that carry anything ends in the tissue that it carries itself.

use super::weights::CageWeights;
use animimic_scene::{Mesh, Rig};
use glam::DVec3;
use rayon::prelude::*;

/// Points along a bone at which its distance to the surface is measured.
const STATIONS: usize = 7;
/// A vertex belongs to the flesh of a joint from this weight on.
const OWN: f64 = 0.3;

/// One straight piece of a joint.
#[derive(Clone, Debug)]
pub struct Bone {
    /// Joint that moves it, as an index into [`CageWeights::joints`].
    pub joint: usize,
    /// Its ends at rest, world space [model unit].
    pub ends: [DVec3; 2],
    /// Whether another bone begins at each end, against which this one turns.
    pub jointed: [bool; 2],
    /// Distance to the surface of its own flesh at equal steps from end to end [model unit].
    thickness: [f64; STATIONS],
}

/// A point's place beside a bone.
#[derive(Clone, Copy, Debug)]
pub struct Beside {
    /// Distance to the bone [model unit].
    pub distance: f64,
    /// Distance along the bone to the nearest jointed end, infinite if there is none [model unit].
    pub to_joint: f64,
    /// Thickness of the flesh there [model unit].
    pub thickness: f64,
}

impl Bone {
    /// Where a point is relative to the bone.
    pub fn beside(&self, x: DVec3) -> Beside {
        let [a, b] = self.ends;
        let length = a.distance(b);
        let s = if length > 0.0 { ((x - a).dot(b - a) / (length * length)).clamp(0.0, 1.0) } else { 0.0 };
        let along = [s * length, (1.0 - s) * length];
        let to_joint = (0..2).filter(|&e| self.jointed[e]).map(|e| along[e]).fold(f64::INFINITY, f64::min);
        let u = s * (STATIONS - 1) as f64;
        let k = (u as usize).min(STATIONS - 2);
        let thickness = self.thickness[k] + (self.thickness[k + 1] - self.thickness[k]) * (u - k as f64);
        Beside { distance: x.distance(a.lerp(b, s)), to_joint, thickness }
    }
}

/// The bones of every joint that carries something.
pub fn bones(rig: &Rig, rest: &[DVec3], mesh: &Mesh, weights: &CageWeights) -> Vec<Bone> {
    let live = live(rig, &weights.joints);
    let flesh: Vec<Vec<usize>> = flesh(rig, weights);
    let mut bones = Vec::new();
    for (column, &joint) in weights.joints.iter().enumerate() {
        let below = (0..live.len()).filter(|&c| live[c] && rig.skeleton.joints[c].parent == Some(joint));
        let above = rig.skeleton.joints[joint].parent.is_some_and(|p| carries_above(rig, weights, p));
        let mut ends: Vec<(DVec3, bool)> = below.map(|c| (rest[c], true)).collect();
        if ends.is_empty() {
            ends.push((tip(rest[joint], &flesh[column], &mesh.positions), false));
        }
        let bone = |(end, jointed)| Bone {
            joint: column,
            ends: [rest[joint], end],
            jointed: [above, jointed],
            thickness: [0.0; STATIONS],
        };
        bones.extend(ends.into_iter().map(bone));
    }
    let own: Vec<Vec<[DVec3; 3]>> = flesh.iter().map(|f| triangles(mesh, f)).collect();
    bones.par_iter_mut().for_each(|bone| {
        let at = |k: usize| bone.ends[0].lerp(bone.ends[1], k as f64 / (STATIONS - 1) as f64);
        let nearest = |p: DVec3| own[bone.joint].iter().map(|t| distance(p, t)).fold(f64::INFINITY, f64::min);
        bone.thickness = std::array::from_fn(|k| nearest(at(k))).map(|d: f64| if d.is_finite() { d } else { 0.0 });
    });
    bones
}

/// Joints that carry weight themselves or through one below.
pub(super) fn live(rig: &Rig, carrying: &[usize]) -> Vec<bool> {
    let joints = &rig.skeleton.joints;
    let mut live = vec![false; joints.len()];
    carrying.iter().for_each(|&j| live[j] = true);
    for j in (0..joints.len()).rev() {
        if let (true, Some(p)) = (live[j], joints[j].parent) {
            live[p] = true;
        }
    }
    live
}

fn carries_above(rig: &Rig, weights: &CageWeights, joint: usize) -> bool {
    let mut at = Some(joint);
    while let Some(j) = at {
        if weights.joints.binary_search(&j).is_ok() {
            return true;
        }
        at = rig.skeleton.joints[j].parent;
    }
    false
}

/// Surface vertices of each joint's flesh, \[index into joints\].
fn flesh(rig: &Rig, weights: &CageWeights) -> Vec<Vec<usize>> {
    let mut out = vec![Vec::new(); weights.joints.len()];
    for (v, influences) in rig.skin.influences.iter().enumerate() {
        let mut own: Vec<(usize, f64)> = Vec::new();
        for i in influences {
            let joint = rig.skin.slots[i.slot as usize].joint;
            let column = weights.joints.binary_search(&joint).expect("joints are those of the skin");
            match own.iter_mut().find(|o| o.0 == column) {
                Some(o) => o.1 += i.weight,
                None => own.push((column, i.weight)),
            }
        }
        own.iter().filter(|o| o.1 >= OWN).for_each(|o| out[o.0].push(v));
    }
    out
}

/// The end of a last bone: through the centre of its flesh, as far as that reaches.
fn tip(joint: DVec3, flesh: &[usize], positions: &[DVec3]) -> DVec3 {
    let center = flesh.iter().map(|&v| positions[v]).sum::<DVec3>() / flesh.len().max(1) as f64;
    let axis = (center - joint).normalize_or_zero();
    let reach = flesh.iter().map(|&v| (positions[v] - joint).dot(axis)).fold(0.0, f64::max);
    if flesh.is_empty() { joint } else { joint + axis * reach }
}

/// Triangles with a corner in a set of vertices (ascending).
fn triangles(mesh: &Mesh, flesh: &[usize]) -> Vec<[DVec3; 3]> {
    let inside = |v: &u32| flesh.binary_search(&(*v as usize)).is_ok();
    let touching = mesh.triangles.iter().filter(|t| t.iter().any(inside));
    touching.map(|t| t.map(|v| mesh.positions[v as usize])).collect()
}

/// Distance of a point from a triangle (Ericson 2005, §5.1.5).
fn distance(p: DVec3, [a, b, c]: &[DVec3; 3]) -> f64 {
    let (ab, ac, ap) = (*b - *a, *c - *a, p - *a);
    let n = ab.cross(ac);
    let area2 = n.length_squared();
    if area2 > 0.0 {
        let (v, w) = (ap.cross(ac).dot(n) / area2, ab.cross(ap).dot(n) / area2);
        if v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
            return ap.dot(n).abs() / area2.sqrt();
        }
    }
    let edge = |from: DVec3, to: DVec3| {
        let d = to - from;
        let s = ((p - from).dot(d) / d.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        p.distance(from + d * s)
    };
    edge(*a, *b).min(edge(*b, *c)).min(edge(*c, *a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_to_a_triangle_is_that_of_its_nearest_point() {
        let t = [DVec3::ZERO, DVec3::X, DVec3::Y];
        for (p, d) in [
            (DVec3::new(0.2, 0.2, 0.5), 0.5),
            (DVec3::new(-3.0, -4.0, 0.0), 5.0),
            (DVec3::new(1.0, 1.0, 0.0), 0.5f64.sqrt()),
            (DVec3::new(0.5, -2.0, 0.0), 2.0),
        ] {
            assert!((distance(p, &t) - d).abs() < 1e-12, "{p}");
        }
    }

    #[test]
    fn beside_a_bone_the_nearer_jointed_end_counts() {
        let bone = Bone { joint: 0, ends: [DVec3::ZERO, DVec3::X], jointed: [true, false], thickness: [0.5; STATIONS] };
        let there = bone.beside(DVec3::new(0.75, 0.2, 0.0));
        assert!((there.distance - 0.2).abs() < 1e-12 && (there.to_joint - 0.75).abs() < 1e-12);
        assert!((there.thickness - 0.5).abs() < 1e-12);
    }
}

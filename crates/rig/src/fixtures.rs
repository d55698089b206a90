//! A generated rigged creature that has what real files have: for tests, examples and benches of every crate that poses.
//!
//! Several roots, a part that floats beside the body, an IK foot that hangs under the armature although its geometry belongs to
//! the leg, scaled and mirrored joints, vertices with up to three influences, and vertex buffers in another space than the world.

use animimic_scene::rig::{Influence, Joint, Skeleton, Skin, Slot};
use animimic_scene::{Mesh, Rig, Transform};
use glam::{DAffine3, DMat3, DQuat, DVec3};

/// Vertices per ring of a tube, and rings.
const AROUND: usize = 7;
const RINGS: usize = 9;

/// Joints of the creature, in skeleton order.
pub mod joint {
    /// Weightless root.
    pub const ARMATURE: usize = 0;
    /// IK foot under the armature; its geometry hangs on the shin.
    pub const FOOT: usize = 1;
    /// Rear of the body.
    pub const HIP: usize = 2;
    /// Middle of the body.
    pub const SPINE: usize = 3;
    /// Front of the body.
    pub const CHEST: usize = 4;
    /// Upper leg.
    pub const THIGH: usize = 5;
    /// Lower leg.
    pub const SHIN: usize = 6;
    /// A hand that floats beside the chest.
    pub const HAND: usize = 7;
    /// A second root with geometry of its own.
    pub const PROP: usize = 8;
    /// A joint below the chest that moves nothing.
    pub const MARKER: usize = 9;
}

/// A creature with two roots.
pub fn creature() -> (Rig, Mesh) {
    build(true)
}

/// The creature without its second root, and with one vertex that half belongs to the joint above the solved root.
pub fn creature_with_stray_weight() -> (Rig, Mesh) {
    let (mut rig, mesh) = build(false);
    let above = slot_of(joint::ARMATURE);
    rig.skin.influences[0].iter_mut().for_each(|i| i.weight *= 0.5);
    rig.skin.influences[0].insert(0, Influence { slot: above, weight: 0.5 });
    (rig, mesh)
}

fn slot_of(joint: usize) -> u32 {
    joint as u32
}

/// Rest transforms in world space \[joint\], and parents.
fn rest() -> Vec<(Option<usize>, DAffine3)> {
    let at = |x: f64, y: f64, z: f64, turn: f64, scale: DVec3| {
        let axis = DVec3::new(0.3, 0.8, -0.5).normalize();
        DAffine3::from_scale_rotation_translation(scale, DQuat::from_axis_angle(axis, turn), DVec3::new(x, y, z))
    };
    let one = DVec3::ONE;
    vec![
        (None, at(0.0, 0.0, 0.0, 0.4, one)),
        (Some(joint::ARMATURE), at(0.7, 0.25, 0.0, 0.4, DVec3::new(1.5, 0.7, -1.2))),
        (Some(joint::ARMATURE), at(0.0, 1.0, 0.0, 1.1, one * 2.0)),
        (Some(joint::HIP), at(0.7, 1.0, 0.0, -0.7, one * 2.0)),
        (Some(joint::SPINE), at(1.4, 1.0, 0.0, 0.2, one * 0.5)),
        (Some(joint::SPINE), at(0.7, 0.95, 0.0, 2.0, one)),
        (Some(joint::THIGH), at(0.7, 0.6, 0.02, 0.0, one)),
        (Some(joint::CHEST), at(1.9, 0.5, 0.6, 0.9, one)),
        (None, at(0.0, 0.2, 2.0, 0.3, one * 3.0)),
        (Some(joint::CHEST), at(2.2, 1.0, 0.0, 0.0, one)),
    ]
}

fn build(with_prop: bool) -> (Rig, Mesh) {
    use joint::{CHEST, FOOT, HAND, HIP, PROP, SHIN, SPINE, THIGH};
    let mut mesh = Mesh::default();
    let mut weights: Vec<Vec<(usize, f64)>> = Vec::new();
    let mut tube = |from: DVec3, to: DVec3, radius: f64, stations: &[(f64, usize)]| {
        push_tube(&mut mesh, from, to, radius);
        for ring in 0..RINGS {
            let u = ring as f64 / (RINGS - 1) as f64;
            weights.extend(std::iter::repeat_n(falloff(u, stations), AROUND));
        }
    };
    tube(DVec3::new(0.0, 1.0, 0.0), DVec3::new(2.1, 1.0, 0.0), 0.25, &[(0.0, HIP), (0.5, SPINE), (1.0, CHEST)]);
    tube(DVec3::new(0.7, 0.95, 0.0), DVec3::new(0.7, 0.0, 0.0), 0.1, &[(0.0, THIGH), (0.5, SHIN), (1.0, FOOT)]);
    tube(DVec3::new(1.9, 0.5, 0.6), DVec3::new(2.2, 0.4, 0.7), 0.1, &[(0.0, HAND)]);
    if with_prop {
        tube(DVec3::new(0.0, 0.2, 2.0), DVec3::new(0.0, 1.2, 2.2), 0.2, &[(0.0, PROP)]);
    }
    mesh.welded = (0..mesh.positions.len() as u32).collect();
    mesh.welded_count = mesh.positions.len();
    let count = if with_prop { PROP + 2 } else { PROP };
    (rig(&mesh, &weights, count), mesh)
}

fn rig(mesh: &Mesh, weights: &[Vec<(usize, f64)>], count: usize) -> Rig {
    let rest = rest();
    let joints = (0..count)
        .map(|j| {
            let (parent, world) = rest[j];
            let above = parent.map_or(DAffine3::IDENTITY, |p| rest[p].1);
            Joint {
                name: format!("joint{j}"),
                parent,
                rest: Transform::from_affine(above.inverse() * world),
                node: None,
            }
        })
        .collect();
    let skeleton = Skeleton { joints };
    let world = skeleton.rest_world();
    // The vertex buffer is in centimetres and lies on its back.
    let world_from_buffer = DAffine3::from_mat3(DMat3::from_rotation_x(-1.5) * 0.01);
    let slots = (0..count).map(|j| Slot { joint: j, inverse_bind: world[j].inverse() * world_from_buffer }).collect();
    let influences =
        weights.iter().map(|w| w.iter().map(|&(j, weight)| Influence { slot: slot_of(j), weight }).collect()).collect();
    let bind_positions = mesh.positions.iter().map(|&x| world_from_buffer.inverse().transform_point3(x)).collect();
    Rig { skeleton, skin: Skin { slots, bind_positions, influences } }
}

/// Smooth weights of the stations (position along the tube, joint), largest first, summing to 1.
fn falloff(u: f64, stations: &[(f64, usize)]) -> Vec<(usize, f64)> {
    let raw: Vec<f64> = stations.iter().map(|(s, _)| (-((u - s) / 0.25).powi(2)).exp()).collect();
    let total: f64 = raw.iter().sum();
    let mut weights: Vec<(usize, f64)> = stations.iter().zip(raw).map(|(s, w)| (s.1, w / total)).collect();
    weights.sort_by(|a, b| b.1.total_cmp(&a.1));
    weights
}

fn push_tube(mesh: &mut Mesh, from: DVec3, to: DVec3, radius: f64) {
    let base = mesh.positions.len() as u32;
    let axis = (to - from).normalize();
    let (a, b) = axis.any_orthonormal_pair();
    for ring in 0..RINGS {
        let center = from.lerp(to, ring as f64 / (RINGS - 1) as f64);
        for k in 0..AROUND {
            let (s, c) = (std::f64::consts::TAU * k as f64 / AROUND as f64).sin_cos();
            mesh.positions.push(center + (a * c + b * s) * radius);
        }
    }
    let at = |ring: usize, k: usize| base + (ring * AROUND + k % AROUND) as u32;
    for ring in 0..RINGS - 1 {
        for k in 0..AROUND {
            mesh.triangles.push([at(ring, k), at(ring, k + 1), at(ring + 1, k)]);
            mesh.triangles.push([at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)]);
        }
    }
}

//! A creature made by code with three soft arms of different stiffness on one body: for tests of every crate that softens.
//!
//! Its surface is the boundary of a set of cubes, closed and of one piece; each arm has a joint of its own that never turns. What its
//! arms do when the body is shaken tells their stiffness.

use animimic_scene::{
    Asset, Camera, Influence, Joint, Look, Mesh, Motion, Part, Pose, Rig, Skeleton, Skin, Slot, Transform,
};
use glam::{DAffine3, DQuat, DVec3, IVec3};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Side of a cube [model unit].
const CUBE: f64 = 0.05;
/// Cubes of the body along each axis, from the origin.
const BODY: IVec3 = IVec3::new(10, 5, 5);
/// Length and thickness of an arm [cubes].
const LENGTH: i32 = 9;
const THICK: i32 = 2;
/// Where each arm leaves the body [cubes], and along which axis.
const ARMS: [(IVec3, IVec3); 3] =
    [(IVec3::new(1, 5, 2), IVec3::Y), (IVec3::new(7, 5, 1), IVec3::Y), (IVec3::new(10, 1, 2), IVec3::X)];
/// Over this length weights pass from the body to an arm [model unit].
const BLEND: f64 = 0.1;

/// Joints of the arms.
pub const ARM_JOINTS: [usize; 3] = [1, 2, 3];

/// The creature at rest.
pub fn three_arms() -> Asset {
    let mut mesh = boundary();
    let count = mesh.positions.len();
    mesh.welded = (0..count as u32).collect();
    mesh.welded_count = count;
    mesh.parts = vec![Part { vertices: 0..count, triangles: 0..mesh.triangles.len(), ..Part::default() }];
    let wave = |p: DVec3, k: DVec3| (0.5 + 0.42 * (k.dot(p)).sin()) as f32;
    let color = |p: &DVec3| {
        [
            wave(*p, DVec3::new(31.0, 17.0, 23.0)),
            wave(*p, DVec3::new(-19.0, 37.0, 11.0)),
            wave(*p, DVec3::new(13.0, -29.0, 41.0)),
        ]
    };
    mesh.colors = mesh.positions.iter().map(color).collect();
    let mut joints = vec![Joint { name: "body".into(), parent: None, rest: Transform::IDENTITY, node: None }];
    for (k, (at, along)) in ARMS.iter().enumerate() {
        let rest = Transform { translation: root(*at, *along), ..Transform::IDENTITY };
        joints.push(Joint { name: format!("arm_{k}"), parent: Some(0), rest, node: None });
    }
    let skeleton = Skeleton { joints };
    let world = skeleton.rest_world();
    let slots = world.iter().enumerate().map(|(joint, w)| Slot { joint, inverse_bind: DAffine3::inverse(w) }).collect();
    let influences = mesh.positions.iter().map(|p| influences(*p)).collect();
    let skin = Skin { slots, bind_positions: mesh.positions.clone(), influences };
    let looks = vec![Look { double_sided: true, ..Look::default() }];
    Asset { mesh, rig: Rig { skeleton, skin }, looks, ..Asset::default() }
}

/// The middle of an arm's root.
fn root(at: IVec3, along: IVec3) -> DVec3 {
    let across = (IVec3::ONE - along).as_dvec3() * (0.5 * f64::from(THICK));
    (at.as_dvec3() + across) * CUBE
}

fn influences(p: DVec3) -> Vec<Influence> {
    for (k, (at, along)) in ARMS.iter().enumerate() {
        let from_root = p - root(*at, *along);
        let out = from_root.dot(along.as_dvec3());
        let aside = (from_root - along.as_dvec3() * out).abs().max_element();
        if out > 0.0 && aside < (0.5 * f64::from(THICK) + 0.1) * CUBE {
            let u = (out / BLEND).min(1.0);
            let weight = u * u * (3.0 - 2.0 * u);
            let arm = Influence { slot: ARM_JOINTS[k] as u32, weight };
            return if weight < 1.0 { vec![Influence { slot: 0, weight: 1.0 - weight }, arm] } else { vec![arm] };
        }
    }
    vec![Influence { slot: 0, weight: 1.0 }]
}

fn filled(c: IVec3) -> bool {
    let within = |low: IVec3, size: IVec3| (0..3).all(|k| (low[k]..low[k] + size[k]).contains(&c[k]));
    let arm = |(at, along): &(IVec3, IVec3)| within(*at, *along * LENGTH + (IVec3::ONE - *along) * THICK);
    within(IVec3::ZERO, BODY) || ARMS.iter().any(arm)
}

/// Sides of filled cubes that no other filled cube touches.
fn boundary() -> Mesh {
    let mut mesh = Mesh::default();
    let mut number: BTreeMap<[i32; 3], u32> = BTreeMap::new();
    let reach = BODY.max_element() + LENGTH;
    for c in
        (0..reach.pow(3)).map(|n| IVec3::new(n % reach, n / reach % reach, n / reach / reach)).filter(|c| filled(*c))
    {
        for axis in 0..3 {
            for side in [0, 1] {
                let unit = IVec3::from_array(std::array::from_fn(|k| i32::from(k == axis)));
                if filled(c + unit * (2 * side - 1)) {
                    continue;
                }
                let (u, v) = (
                    IVec3::from_array(std::array::from_fn(|k| i32::from(k == (axis + 1) % 3))),
                    IVec3::from_array(std::array::from_fn(|k| i32::from(k == (axis + 2) % 3))),
                );
                let corner = c + unit * side;
                let mut at = |p: IVec3| {
                    *number.entry(p.to_array()).or_insert_with(|| {
                        mesh.positions.push(p.as_dvec3() * CUBE);
                        mesh.positions.len() as u32 - 1
                    })
                };
                let q = [at(corner), at(corner + u), at(corner + u + v), at(corner + v)];
                let q = if side == 1 { q } else { [q[0], q[3], q[2], q[1]] };
                mesh.triangles.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
            }
        }
    }
    mesh
}

/// A clip in which the body is shaken and turned, from rest; the arms' joints stay as they are.
pub fn shaken(asset: &Asset, frames: usize, fps: f64) -> Motion {
    let skeleton = &asset.rig.skeleton;
    let pose = |t: usize| {
        let time = t as f64 / fps;
        let onset = (time / 0.25).min(1.0);
        let onset = onset * onset * (3.0 - 2.0 * onset);
        let wave = |hertz: f64, phase: f64| onset * ((TAU * hertz * time + phase).sin() - phase.sin());
        let mut locals = skeleton.rest_locals();
        locals[0].translation += DVec3::new(0.10 * wave(1.3, 0.0), 0.08 * wave(1.7, 0.6), 0.05 * wave(1.1, 0.3));
        locals[0].rotation =
            DQuat::from_scaled_axis(DVec3::new(0.1 * wave(0.8, 0.2), 0.15 * wave(0.9, 0.0), 0.25 * wave(1.2, 1.0)));
        Pose { locals }
    };
    Motion { name: "shaken".into(), fps, poses: (0..frames).map(pose).collect() }
}

/// A camera that sees all of it, `size` pixels wide and high.
pub fn camera(size: u32) -> Camera {
    Camera::orbit(DVec3::new(0.4, 0.3, 0.12), 3.2, 0.35, 0.2, 0.5, size, size)
}

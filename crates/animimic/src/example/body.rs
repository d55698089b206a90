//! Where the creature's bones are and how thick it is around them.

use super::blend::{Primitive, Shape};
use animimic_scene::{Joint, Skeleton, Transform};
use glam::DVec3;

/// Corners of the box that is meshed [m].
pub const LOW: DVec3 = DVec3::new(-0.5, -0.06, -1.48);
/// The upper corner.
pub const HIGH: DVec3 = DVec3::new(0.5, 1.56, 1.02);
/// Edge of a grid cell [m]: ears are about three cells thick.
pub const CELL: f64 = 0.027;

/// Joints: name, parent, position [m]. Left is +x; the creature looks along +z.
const JOINTS: &[(&str, Option<usize>, [f64; 3])] = &[
    ("hips", None, [0.0, 0.62, -0.30]),
    ("spine", Some(0), [0.0, 0.63, -0.06]),
    ("chest", Some(1), [0.0, 0.62, 0.18]),
    ("neck", Some(2), [0.0, 0.72, 0.33]),
    ("head", Some(3), [0.0, 0.89, 0.44]),
    ("ear_left_1", Some(4), [0.12, 1.13, 0.47]),
    ("ear_left_2", Some(5), [0.17, 1.27, 0.45]),
    ("ear_right_1", Some(4), [-0.12, 1.13, 0.47]),
    ("ear_right_2", Some(7), [-0.17, 1.27, 0.45]),
    ("front_left_upper", Some(2), [0.14, 0.55, 0.20]),
    ("front_left_lower", Some(9), [0.15, 0.32, 0.17]),
    ("front_left_paw", Some(10), [0.15, 0.12, 0.21]),
    ("front_right_upper", Some(2), [-0.14, 0.55, 0.20]),
    ("front_right_lower", Some(12), [-0.15, 0.32, 0.17]),
    ("front_right_paw", Some(13), [-0.15, 0.12, 0.21]),
    ("hind_left_upper", Some(0), [0.12, 0.56, -0.32]),
    ("hind_left_lower", Some(15), [0.16, 0.34, -0.23]),
    ("hind_left_paw", Some(16), [0.15, 0.16, -0.38]),
    ("hind_right_upper", Some(0), [-0.12, 0.56, -0.32]),
    ("hind_right_lower", Some(18), [-0.16, 0.34, -0.23]),
    ("hind_right_paw", Some(19), [-0.15, 0.16, -0.38]),
    ("tail", Some(0), [0.0, 0.68, -0.46]),
];

/// The joints as a skeleton; all rest rotations are the identity.
pub fn skeleton() -> Skeleton {
    let joints = JOINTS
        .iter()
        .map(|&(name, parent, p)| {
            let origin = parent.map_or(DVec3::ZERO, |k| DVec3::from_array(JOINTS[k].2));
            let rest = Transform { translation: DVec3::from_array(p) - origin, ..Transform::IDENTITY };
            Joint { name: name.to_owned(), parent, rest, node: None }
        })
        .collect();
    Skeleton { joints }
}

/// What surrounds the bones, each with the joint that it follows.
pub fn primitives() -> Vec<Primitive> {
    let at = |name: &str| {
        let (index, joint) =
            JOINTS.iter().enumerate().find(|(_, j)| j.0 == name).expect("names below are those of JOINTS");
        (index, DVec3::from_array(joint.2))
    };
    let mut out = Vec::new();
    let mut cone = |joint: &str, a: DVec3, b: DVec3, radii: [f64; 2], flatten: Option<(DVec3, f64)>| {
        out.push(Primitive { joint: at(joint).0, shape: Shape::Cone { a, b, radii, flatten } });
    };
    let v = DVec3::new;
    cone("hips", at("hips").1 - v(0.0, 0.02, 0.03), at("spine").1, [0.175, 0.17], None);
    cone("spine", at("spine").1 - v(0.0, 0.03, 0.0), at("chest").1 - v(0.0, 0.02, 0.05), [0.18, 0.19], None);
    cone("chest", at("chest").1, at("neck").1, [0.185, 0.125], None);
    cone("neck", at("neck").1, at("head").1, [0.12, 0.115], None);
    for (side, sign) in [("left", 1.0), ("right", -1.0)] {
        let mirrored = |x: f64, y: f64, z: f64| v(sign * x, y, z);
        let name = |part: &str, end: &str| part.replace("SIDE", side) + end;
        // Ears are flattened across the line of sight from the front, turned a little outwards.
        let across = mirrored(0.45, 0.1, 1.0).normalize();
        let ear = at(&name("ear_SIDE_1", "")).1;
        let ear_mid = at(&name("ear_SIDE_2", "")).1;
        cone(&name("ear_SIDE_1", ""), ear - mirrored(0.015, 0.06, 0.0), ear_mid, [0.095, 0.085], Some((across, 0.5)));
        cone(&name("ear_SIDE_2", ""), ear_mid, mirrored(0.235, 1.46, 0.42), [0.085, 0.036], Some((across, 0.5)));
        let (shoulder, elbow, wrist) = (
            at(&name("front_SIDE_upper", "")).1,
            at(&name("front_SIDE_lower", "")).1,
            at(&name("front_SIDE_paw", "")).1,
        );
        cone(&name("front_SIDE_upper", ""), shoulder, elbow, [0.10, 0.066], None);
        cone(&name("front_SIDE_lower", ""), elbow, wrist, [0.066, 0.054], None);
        cone(&name("front_SIDE_paw", ""), wrist - v(0.0, 0.05, 0.0), wrist + v(0.0, -0.06, 0.07), [0.06, 0.058], None);
        let (hip, knee, hock) =
            (at(&name("hind_SIDE_upper", "")).1, at(&name("hind_SIDE_lower", "")).1, at(&name("hind_SIDE_paw", "")).1);
        cone(&name("hind_SIDE_upper", ""), hip, knee, [0.135, 0.088], None);
        cone(&name("hind_SIDE_lower", ""), knee, hock, [0.082, 0.05], None);
        cone(&name("hind_SIDE_paw", ""), hock, hock - v(0.0, 0.09, -0.05), [0.05, 0.055], None);
        cone(&name("hind_SIDE_paw", ""), hock - v(0.0, 0.095, -0.04), hock - v(0.0, 0.10, -0.12), [0.058, 0.056], None);
    }
    // One joint for all of it: it bends where no joint is.
    let tail = [at("tail").1, v(0.0, 0.79, -0.66), v(0.0, 0.92, -0.84), v(0.0, 1.06, -1.00), v(0.0, 1.26, -1.13)];
    cone("tail", tail[0] + v(0.0, -0.04, 0.06), tail[1], [0.085, 0.095], None);
    cone("tail", tail[1], tail[2], [0.095, 0.125], None);
    cone("tail", tail[2], tail[3], [0.125, 0.115], None);
    cone("tail", tail[3], tail[4], [0.115, 0.022], None);
    let mut ball = |joint: &str, center: DVec3, radii: DVec3| {
        out.push(Primitive { joint: at(joint).0, shape: Shape::Ellipsoid { center, radii } });
    };
    ball("spine", v(0.0, 0.53, -0.04), v(0.175, 0.15, 0.25));
    ball("head", v(0.0, 0.99, 0.50), v(0.215, 0.185, 0.195));
    ball("head", v(0.0, 0.925, 0.655), v(0.115, 0.085, 0.125));
    ball("head", v(0.0, 0.955, 0.765), v(0.035, 0.028, 0.03));
    out
}

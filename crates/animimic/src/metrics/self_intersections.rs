//! Self-intersections: pairs of faces that cross, minus those at rest (generated meshes start above 0).
//!
//! Faces that share a welded vertex are neighbours and never counted. Two triangles cross when an edge of one passes
//! through the inside of the other: five orientation signs (Guigue & Devillers 2003, §2). Signs that are exactly zero
//! (touching, coplanar) are no crossing. Candidates come from a median-split box tree that is asked about itself.

use super::{Evidence, Metric, Missing, Reading, mean};
use animimic_scene::Mesh;
use glam::DVec3;
use rayon::prelude::*;

pub struct SelfIntersections;

impl Metric for SelfIntersections {
    fn name(&self) -> &'static str {
        "self-intersections"
    }

    fn definition(&self) -> &'static str {
        "pairs of faces without a common vertex that cross, minus those at rest, mean and max over frames"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let counts: Vec<f64> = e.frames.par_iter().map(|f| intersecting_pairs(&e.asset.mesh, f) as f64).collect();
        let rest = intersecting_pairs(&e.asset.mesh, &e.asset.mesh.positions) as f64;
        Ok(vec![
            ("self_intersections_rest".into(), rest),
            ("self_intersections_mean".into(), mean(counts.iter().map(|c| c - rest))),
            ("self_intersections_max".into(), counts.iter().copied().fold(0.0, f64::max) - rest),
        ])
    }
}

/// Number of pairs of faces that cross when the mesh's vertices stand at `positions`.
pub fn intersecting_pairs(mesh: &Mesh, positions: &[DVec3]) -> usize {
    let mut count = 0;
    each_crossing(mesh, positions, |_, _| count += 1);
    count
}

/// Pairs of triangles that cross when the mesh's vertices stand at `positions`, the lower index first, ascending.
pub fn crossing_triangles(mesh: &Mesh, positions: &[DVec3]) -> Vec<[u32; 2]> {
    let mut pairs = Vec::new();
    each_crossing(mesh, positions, |a, b| pairs.push([a.min(b), a.max(b)]));
    pairs.sort_unstable();
    pairs
}

fn each_crossing(mesh: &Mesh, positions: &[DVec3], mut found: impl FnMut(u32, u32)) {
    let faces: Vec<Face> = mesh
        .triangles
        .iter()
        .enumerate()
        .map(|(k, t)| Face {
            triangle: k as u32,
            corner: t.map(|i| positions[i as usize]),
            welded: t.map(|i| mesh.welded[i as usize]),
        })
        .filter(|f| f.welded[0] != f.welded[1] && f.welded[1] != f.welded[2] && f.welded[0] != f.welded[2])
        .collect();
    if faces.is_empty() {
        return;
    }
    let mut order: Vec<u32> = (0..faces.len() as u32).collect();
    let mut nodes = Vec::new();
    build(&faces, &mut order, 0, &mut nodes);
    // A stack of node pairs instead of recursion: each unordered pair of leaves is visited once.
    let mut stack = vec![(0u32, 0u32)];
    let mut test = |p: u32, q: u32| {
        let (a, b) = (&faces[p as usize], &faces[q as usize]);
        if cross(a, b) {
            found(a.triangle, b.triangle);
        }
    };
    while let Some((i, j)) = stack.pop() {
        let (a, b) = (&nodes[i as usize], &nodes[j as usize]);
        if i != j && !overlap(a, b) {
            continue;
        }
        match (a.children, b.children) {
            _ if i == j => match a.children {
                Some([l, r]) => stack.extend([(l, l), (r, r), (l, r)]),
                None => {
                    let own = &order[a.first..a.first + a.count];
                    for (k, &p) in own.iter().enumerate() {
                        own[k + 1..].iter().for_each(|&q| test(p, q));
                    }
                }
            },
            (Some([l, r]), _) if a.count >= b.count || b.children.is_none() => stack.extend([(l, j), (r, j)]),
            (_, Some([l, r])) => stack.extend([(i, l), (i, r)]),
            _ => {
                for &p in &order[a.first..a.first + a.count] {
                    order[b.first..b.first + b.count].iter().for_each(|&q| test(p, q));
                }
            }
        }
    }
}

struct Face {
    triangle: u32,
    corner: [DVec3; 3],
    welded: [u32; 3],
}

struct Node {
    lo: DVec3,
    hi: DVec3,
    /// Range of `order` below this node.
    first: usize,
    count: usize,
    children: Option<[u32; 2]>,
}

/// Faces per leaf: below this, testing all pairs costs less than another level.
const LEAF: usize = 4;

fn build(faces: &[Face], order: &mut [u32], first: usize, nodes: &mut Vec<Node>) -> u32 {
    let corners = || order.iter().flat_map(|&f| faces[f as usize].corner);
    let (lo, hi) = corners().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let index = nodes.len() as u32;
    nodes.push(Node { lo, hi, first, count: order.len(), children: None });
    if order.len() > LEAF {
        let size = hi - lo;
        let axis = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let middle = order.len() / 2;
        let key = |f: &u32| faces[*f as usize].corner.iter().map(|c| c[axis]).sum::<f64>();
        order.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
        let (left, right) = order.split_at_mut(middle);
        let l = build(faces, left, first, nodes);
        let r = build(faces, right, first + middle, nodes);
        nodes[index as usize].children = Some([l, r]);
    }
    index
}

fn overlap(a: &Node, b: &Node) -> bool {
    a.lo.cmple(b.hi).all() && b.lo.cmple(a.hi).all()
}

fn cross(a: &Face, b: &Face) -> bool {
    if a.welded.iter().any(|v| b.welded.contains(v)) {
        return false;
    }
    // Reject quickly: all corners of one strictly on one side of the other's plane.
    let one_side = |t: &[DVec3; 3], u: &[DVec3; 3]| {
        let s = u.map(|p| orient(t, p));
        s.iter().all(|x| *x >= 0.0) || s.iter().all(|x| *x <= 0.0)
    };
    if one_side(&a.corner, &b.corner) || one_side(&b.corner, &a.corner) {
        return false;
    }
    let pierces = |s: &[DVec3; 3], t: &[DVec3; 3]| (0..3).any(|k| segment_pierces(s[k], s[(k + 1) % 3], t));
    pierces(&a.corner, &b.corner) || pierces(&b.corner, &a.corner)
}

/// Six times the signed volume of the tetrahedron (t, p): positive on the side that the normal points away from.
fn orient(t: &[DVec3; 3], p: DVec3) -> f64 {
    (t[0] - p).dot((t[1] - p).cross(t[2] - p))
}

/// Whether the open segment pq passes through the inside of the triangle.
fn segment_pierces(p: DVec3, q: DVec3, t: &[DVec3; 3]) -> bool {
    if orient(t, p) * orient(t, q) >= 0.0 {
        return false;
    }
    let d = q - p;
    let side = |k: usize| d.dot((t[k] - p).cross(t[(k + 1) % 3] - p));
    let s = [side(0), side(1), side(2)];
    s.iter().all(|x| *x > 0.0) || s.iter().all(|x| *x < 0.0)
}

#[cfg(test)]
mod tests {
    use super::super::fixtures;
    use super::*;

    /// Two octahedra, the second displaced.
    fn two(offset: DVec3) -> Mesh {
        let one = fixtures::octahedron();
        let mut mesh = one.clone();
        mesh.positions.extend(one.positions.iter().map(|p| *p + offset));
        mesh.triangles.extend(one.triangles.iter().map(|t| t.map(|i| i + 6)));
        mesh.welded = (0..12).collect();
        mesh.welded_count = 12;
        mesh
    }

    #[test]
    fn a_convex_body_does_not_cross_itself_and_two_apart_do_not_cross_but_overlapping_ones_do() {
        let one = fixtures::octahedron();
        assert_eq!(intersecting_pairs(&one, &one.positions), 0);
        let apart = two(DVec3::X * 2.5);
        assert_eq!(intersecting_pairs(&apart, &apart.positions), 0);
        let overlapping = two(DVec3::new(1.0, 0.1, 0.05));
        let n = intersecting_pairs(&overlapping, &overlapping.positions);
        println!("{n}");
        assert!(n > 0);
    }

    #[test]
    fn the_tree_finds_the_same_pairs_as_testing_all() {
        let mut seed = 7u64;
        let mut random = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 33) as f64 / (1u64 << 31) as f64
        };
        let mut mesh = Mesh::default();
        for i in 0..300u32 {
            let center = DVec3::new(random(), random(), random());
            for _ in 0..3 {
                mesh.positions.push(center + 0.2 * DVec3::new(random(), random(), random()));
            }
            mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        mesh.welded = (0..900).collect();
        mesh.welded_count = 900;
        let face = |t: &[u32; 3]| Face { triangle: 0, corner: t.map(|i| mesh.positions[i as usize]), welded: *t };
        let mut all = 0;
        for (i, a) in mesh.triangles.iter().enumerate() {
            all += mesh.triangles[i + 1..].iter().filter(|b| cross(&face(a), &face(b))).count();
        }
        let tree = intersecting_pairs(&mesh, &mesh.positions);
        println!("{tree} pairs, {all} by brute force");
        assert!(all > 30);
        assert_eq!(tree, all);
    }
}

//! Where a surface crosses itself: pairs of its triangles.
//!
//! Faces that share a welded vertex are neighbours and never counted. Two triangles cross when an edge of one passes
//! through the inside of the other: five orientation signs (Guigue & Devillers 2003, §2). Signs that are exactly zero
//! (touching, coplanar) are no crossing. Candidates come from a tree of boxes that is asked about itself. Its shape is that of the
//! rest pose, made once; each pose only fits the boxes anew, since what is near at rest mostly stays near.

use animimic_scene::Mesh;
use glam::DVec3;

/// Faces per leaf: below this, testing all pairs costs less than another level.
const LEAF: usize = 4;

/// Finds the crossings of one mesh in any pose.
pub struct Crossings<'a> {
    mesh: &'a Mesh,
    /// Triangles with three different corners, in the order of the leaves.
    order: Vec<u32>,
    /// Parents stand before their children.
    nodes: Vec<Node>,
}

struct Node {
    /// Range of `order` below this node.
    first: usize,
    count: usize,
    children: Option<[u32; 2]>,
}

/// What lies below a node in one pose.
#[derive(Clone, Copy)]
struct Extent {
    lo: DVec3,
    hi: DVec3,
    /// Whether any triangle here is asked about.
    asked: bool,
}

impl<'a> Crossings<'a> {
    /// The tree of a mesh, from its rest pose.
    pub fn new(mesh: &'a Mesh) -> Self {
        let whole = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.welded[v as usize]);
            a != b && b != c && a != c
        };
        let mut order: Vec<u32> =
            (0..mesh.triangles.len() as u32).filter(|&k| whole(&mesh.triangles[k as usize])).collect();
        let mut nodes = Vec::new();
        if !order.is_empty() {
            split(mesh, &mut order, 0, &mut nodes);
        }
        Self { mesh, order, nodes }
    }

    /// Pairs of triangles that cross when the vertices stand at `positions`, the lower index first, ascending.
    pub fn pairs(&self, positions: &[DVec3]) -> Vec<[u32; 2]> {
        let mut pairs = Vec::new();
        self.each(positions, |_| true, |pair| pairs.push(pair));
        pairs.sort_unstable();
        pairs
    }

    /// Number of [`Self::pairs`].
    pub fn count(&self, positions: &[DVec3]) -> usize {
        let mut count = 0;
        self.each(positions, |_| true, |_| count += 1);
        count
    }

    /// [`Self::pairs`], where only the vertices that `moved` stand elsewhere than they did when there were the pairs `before`.
    pub fn pairs_after(&self, positions: &[DVec3], moved: &[bool], before: &[[u32; 2]]) -> Vec<[u32; 2]> {
        let anew = |k: u32| self.mesh.triangles[k as usize].iter().any(|&v| moved[v as usize]);
        let mut pairs: Vec<[u32; 2]> = before.iter().filter(|p| !p.iter().any(|&k| anew(k))).copied().collect();
        self.each(positions, anew, |pair| pairs.push(pair));
        pairs.sort_unstable();
        pairs
    }

    /// Crossing pairs of which at least one triangle is `asked` about.
    fn each(&self, positions: &[DVec3], asked: impl Fn(u32) -> bool, mut found: impl FnMut([u32; 2])) {
        let extents = self.extents(positions, &asked);
        let corners = |k: u32| self.mesh.triangles[k as usize].map(|v| positions[v as usize]);
        let welded = |k: u32| self.mesh.triangles[k as usize].map(|v| self.mesh.welded[v as usize]);
        let mut test = |p: u32, q: u32| {
            let neighbours = welded(p).iter().any(|v| welded(q).contains(v));
            if !neighbours && (asked(p) || asked(q)) && cross(&corners(p), &corners(q)) {
                found([p.min(q), p.max(q)]);
            }
        };
        // A stack of pairs of nodes instead of recursion: each unordered pair of leaves is visited once.
        let mut stack = if self.nodes.is_empty() { vec![] } else { vec![(0u32, 0u32)] };
        while let Some((i, j)) = stack.pop() {
            let (a, b) = (&self.nodes[i as usize], &self.nodes[j as usize]);
            let (at, bt) = (&extents[i as usize], &extents[j as usize]);
            if !(at.asked || bt.asked) || i != j && !overlap(at, bt) {
                continue;
            }
            match (a.children, b.children) {
                _ if i == j => match a.children {
                    Some([l, r]) => stack.extend([(l, l), (r, r), (l, r)]),
                    None => {
                        let own = &self.order[a.first..a.first + a.count];
                        for (k, &p) in own.iter().enumerate() {
                            own[k + 1..].iter().for_each(|&q| test(p, q));
                        }
                    }
                },
                (Some([l, r]), _) if a.count >= b.count || b.children.is_none() => stack.extend([(l, j), (r, j)]),
                (_, Some([l, r])) => stack.extend([(i, l), (i, r)]),
                _ => {
                    for &p in &self.order[a.first..a.first + a.count] {
                        self.order[b.first..b.first + b.count].iter().for_each(|&q| test(p, q));
                    }
                }
            }
        }
    }

    fn extents(&self, positions: &[DVec3], asked: impl Fn(u32) -> bool) -> Vec<Extent> {
        let nothing = Extent { lo: DVec3::INFINITY, hi: DVec3::NEG_INFINITY, asked: false };
        let mut extents = vec![nothing; self.nodes.len()];
        for (i, node) in self.nodes.iter().enumerate().rev() {
            let mut all = nothing;
            match node.children {
                Some(children) => {
                    for child in children.map(|c| extents[c as usize]) {
                        all.lo = all.lo.min(child.lo);
                        all.hi = all.hi.max(child.hi);
                        all.asked |= child.asked;
                    }
                }
                None => {
                    for &k in &self.order[node.first..node.first + node.count] {
                        for p in self.mesh.triangles[k as usize].map(|v| positions[v as usize]) {
                            all.lo = all.lo.min(p);
                            all.hi = all.hi.max(p);
                        }
                        all.asked |= asked(k);
                    }
                }
            }
            extents[i] = all;
        }
        extents
    }
}

/// Appends the node of these triangles and, after it, all below it; returns its index.
fn split(mesh: &Mesh, order: &mut [u32], first: usize, nodes: &mut Vec<Node>) -> u32 {
    let index = nodes.len() as u32;
    nodes.push(Node { first, count: order.len(), children: None });
    if order.len() > LEAF {
        let corners = |k: u32| mesh.triangles[k as usize].map(|v| mesh.positions[v as usize]);
        let all = order.iter().flat_map(|&k| corners(k));
        let (lo, hi) = all.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let axis = (hi - lo).max_position();
        let middle = order.len() / 2;
        let key = |k: u32| corners(k).iter().map(|c| c[axis]).sum::<f64>();
        order.select_nth_unstable_by(middle, |&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
        let (left, right) = order.split_at_mut(middle);
        let l = split(mesh, left, first, nodes);
        let r = split(mesh, right, first + middle, nodes);
        nodes[index as usize].children = Some([l, r]);
    }
    index
}

fn overlap(a: &Extent, b: &Extent) -> bool {
    a.lo.cmple(b.hi).all() && b.lo.cmple(a.hi).all()
}

fn cross(a: &[DVec3; 3], b: &[DVec3; 3]) -> bool {
    // Reject quickly: boxes apart, or all corners of one strictly on one side of the other's plane.
    let low = |t: &[DVec3; 3]| t[0].min(t[1]).min(t[2]);
    let high = |t: &[DVec3; 3]| t[0].max(t[1]).max(t[2]);
    if !(low(a).cmple(high(b)).all() && low(b).cmple(high(a)).all()) {
        return false;
    }
    let one_side = |t: &[DVec3; 3], u: &[DVec3; 3]| {
        let s = u.map(|p| orient(t, p));
        s.iter().all(|x| *x >= 0.0) || s.iter().all(|x| *x <= 0.0)
    };
    if one_side(a, b) || one_side(b, a) {
        return false;
    }
    let pierces = |s: &[DVec3; 3], t: &[DVec3; 3]| (0..3).any(|k| segment_pierces(s[k], s[(k + 1) % 3], t));
    pierces(a, b) || pierces(b, a)
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
    use super::*;
    use crate::metrics::fixtures;
    use animimic_math::gradcheck::SplitMix64;

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

    fn count(mesh: &Mesh) -> usize {
        Crossings::new(mesh).count(&mesh.positions)
    }

    #[test]
    fn a_convex_body_does_not_cross_itself_and_two_apart_do_not_cross_but_overlapping_ones_do() {
        assert_eq!(count(&fixtures::octahedron()), 0);
        assert_eq!(count(&two(DVec3::X * 2.5)), 0);
        assert!(count(&two(DVec3::new(1.0, 0.1, 0.05))) > 0);
    }

    /// Loose triangles all over the unit cube.
    fn soup(rng: &mut SplitMix64) -> Mesh {
        let mut random = || rng.uniform();
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
        mesh
    }

    /// At rest, and in poses that the tree was not made for, with all or few vertices moved.
    #[test]
    fn the_tree_finds_the_same_pairs_as_testing_all() {
        let mut rng = SplitMix64(7);
        let mesh = soup(&mut rng);
        let crossings = Crossings::new(&mesh);
        let brute = |x: &[DVec3]| {
            let face = |k: u32| mesh.triangles[k as usize].map(|v| x[v as usize]);
            let all = (0..300u32).flat_map(|a| (a + 1..300).map(move |b| [a, b]));
            all.filter(|&[a, b]| cross(&face(a), &face(b))).collect::<Vec<_>>()
        };
        let rest = crossings.pairs(&mesh.positions);
        println!("{} pairs at rest", rest.len());
        assert!(rest.len() > 30);
        assert_eq!(rest, brute(&mesh.positions));
        let shuffled: Vec<DVec3> = mesh.positions.iter().map(|x| DVec3::new(1.0 - x.z, x.x * x.y, x.y)).collect();
        assert_eq!(crossings.pairs(&shuffled), brute(&shuffled));
        let moved: Vec<bool> = (0..900).map(|_| rng.uniform() < 0.05).collect();
        let step = |x: &DVec3, m: &bool| if *m { *x + 0.1 * DVec3::new(1.0, -1.0, 0.5) } else { *x };
        let after: Vec<DVec3> = mesh.positions.iter().zip(&moved).map(|(x, m)| step(x, m)).collect();
        assert_ne!(brute(&after), rest);
        assert_eq!(crossings.pairs_after(&after, &moved, &rest), brute(&after));
    }
}

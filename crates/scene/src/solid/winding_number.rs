//! The generalised winding number of a triangle soup, w(p) = Σ Ω_t(p) / 4π (Jacobson et al. 2013), evaluated hierarchically.
//!
//! Ω is the solid angle of a triangle (Van Oosterom and Strackee 1983). Far groups of triangles are one dipole, their summed area
//! vector at their centroid (Barill et al. 2018, eq. 6, first term). Every surface component has a tree of its own, because it is asked which
//! component encloses a point, and whether one encloses it twice.

use super::soup::Soup;
use glam::DVec3;

/// A group is far where the distance is more than this many of its radii: errors stay near 1 %.
const FAR: f64 = 3.0;

/// Triangles per leaf.
const LEAF: usize = 8;

/// Components that get a tree of their own, at most; the others share one.
const OWN_TREES: usize = 64;

/// Winding numbers of one soup.
pub struct WindingNumber {
    /// Component (none for the shared one) and its tree.
    trees: Vec<(Option<u32>, Tree)>,
}

/// What encloses a point.
#[derive(Clone, Copy, Debug, Default)]
pub struct Enclosure {
    /// The winding number of all components together.
    pub total: f64,
    /// The largest of single components.
    pub largest: f64,
    /// The component that has it.
    pub component: Option<u32>,
}

impl Enclosure {
    /// Inside the solid, and not where one component overlaps itself: there it cannot be told which of its parts a point is in.
    pub fn is_inside(&self) -> bool {
        self.total > 0.5 && self.largest < 1.5
    }
}

impl WindingNumber {
    /// Builds the trees.
    pub fn new(soup: &Soup) -> Self {
        let mut groups: Vec<Vec<[DVec3; 3]>> = vec![Vec::new(); soup.component_count];
        for (t, &c) in soup.component.iter().enumerate() {
            groups[c as usize].push(soup.corners(t));
        }
        let mut order: Vec<usize> = (0..groups.len()).collect();
        order.sort_by_key(|&c| (std::cmp::Reverse(groups[c].len()), c));
        let mut shared = Vec::new();
        let mut trees = Vec::new();
        for (rank, c) in order.into_iter().enumerate() {
            if rank < OWN_TREES {
                trees.push((Some(c as u32), Tree::new(std::mem::take(&mut groups[c]))));
            } else {
                shared.append(&mut groups[c]);
            }
        }
        if !shared.is_empty() {
            trees.push((None, Tree::new(shared)));
        }
        Self { trees }
    }

    /// The winding numbers at a point.
    pub fn at(&self, p: DVec3) -> Enclosure {
        let mut out = Enclosure::default();
        for (component, tree) in &self.trees {
            let w = tree.at(p);
            out.total += w;
            if component.is_some() && w > out.largest {
                (out.largest, out.component) = (w, *component);
            }
        }
        out
    }
}

struct Node {
    center: DVec3,
    radius: f64,
    /// Σ area × normal.
    area: DVec3,
    triangles: std::ops::Range<usize>,
    /// The first child follows its parent; this is the second. 0 for leaves.
    second: usize,
}

struct Tree {
    triangles: Vec<[DVec3; 3]>,
    nodes: Vec<Node>,
}

impl Tree {
    fn new(triangles: Vec<[DVec3; 3]>) -> Self {
        let mut tree = Self { nodes: Vec::with_capacity(triangles.len() / 2 + 1), triangles };
        tree.build(0..tree.triangles.len());
        tree
    }

    fn build(&mut self, range: std::ops::Range<usize>) -> usize {
        let part = &self.triangles[range.clone()];
        let (mut area, mut weight, mut center) = (DVec3::ZERO, 0.0, DVec3::ZERO);
        for t in part {
            let a = 0.5 * (t[1] - t[0]).cross(t[2] - t[0]);
            area += a;
            weight += a.length();
            center += a.length() * (t[0] + t[1] + t[2]) / 3.0;
        }
        center /= weight.max(f64::MIN_POSITIVE);
        let corners = || part.iter().flatten();
        let radius = corners().map(|v| v.distance(center)).fold(0.0, f64::max);
        let lo = corners().fold(DVec3::INFINITY, |m, v| m.min(*v));
        let size = corners().fold(DVec3::NEG_INFINITY, |m, v| m.max(*v)) - lo;
        let index = self.nodes.len();
        self.nodes.push(Node { center, radius, area, triangles: range.clone(), second: 0 });
        if range.len() > LEAF {
            let axis = if size.x >= size.y.max(size.z) {
                0
            } else if size.y >= size.z {
                1
            } else {
                2
            };
            let middle = range.len() / 2;
            let key = |t: &[DVec3; 3]| t[0][axis] + t[1][axis] + t[2][axis];
            self.triangles[range.clone()].select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)));
            self.build(range.start..range.start + middle);
            self.nodes[index].second = self.build(range.start + middle..range.end);
        }
        index
    }

    fn at(&self, p: DVec3) -> f64 {
        let mut sum = 0.0;
        let mut stack = vec![0usize];
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index];
            let d = node.center - p;
            let r2 = d.length_squared();
            if r2 > (FAR * node.radius).powi(2) {
                sum += node.area.dot(d) / (r2 * r2.sqrt());
            } else if node.second == 0 {
                sum += self.triangles[node.triangles.clone()].iter().map(|t| solid_angle(t, p)).sum::<f64>();
            } else {
                stack.push(node.second);
                stack.push(index + 1);
            }
        }
        sum / (4.0 * std::f64::consts::PI)
    }
}

/// Signed solid angle of a triangle, positive from behind (inside).
pub(super) fn solid_angle(t: &[DVec3; 3], p: DVec3) -> f64 {
    let [a, b, c] = t.map(|v| v - p);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let y = a.dot(b.cross(c));
    let x = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * y.atan2(x)
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::sphere;
    use super::super::soup::Soup;
    use super::*;

    #[test]
    fn a_ball_encloses_its_inside_once_and_the_tree_agrees_with_the_plain_sum() {
        let mesh = sphere(DVec3::ZERO, 1.0, 48, 24);
        let soup = Soup::new(&mesh).expect("the fixture is sound");
        let winding = WindingNumber::new(&soup);
        let (mut worst, mut wrong) = (0.0f64, 0.0f64);
        for k in 0..400 {
            let f = |m: f64| ((k as f64 + 0.5) * m).fract() * 3.0 - 1.5;
            let p = DVec3::new(f(0.618), f(0.414), f(0.732));
            let plain: f64 = (0..soup.triangles.len()).map(|t| solid_angle(&soup.corners(t), p)).sum::<f64>()
                / (4.0 * std::f64::consts::PI);
            let w = winding.at(p).total;
            worst = worst.max((w - plain).abs());
            if (p.length() - 1.0).abs() > 0.02 {
                wrong = wrong.max((w - f64::from(u8::from(p.length() < 1.0))).abs());
            }
        }
        println!("tree against sum {worst:.1e}, against 0 or 1 {wrong:.1e}");
        assert!(worst < 0.02 && wrong < 0.02);
    }
}

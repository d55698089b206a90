//! The curve skeleton of a solid as a tree of medial balls.
//!
//! Each end of the solid ([`super::tips`]) is joined to the tree by the way that keeps to the middle, cheapest where the solid is deep
//! (TEASAR, Sato et al. 2000; Hassouna and Farag 2009 for costs that fall with depth). Nothing here asks for a closed, manifold or
//! connected surface.

use super::solid::{NONE, Solid};
use super::symmetry::Mirror;
use super::tips::{Tip, tips};
use glam::DVec3;

/// Cost of a step ∝ depth to this power, negative: ways keep to the middle of limbs of all widths alike.
const CENTRING: f64 = 3.0;

/// An end sticks out by this share of the longest side at least.
const LEAST_LENGTH: f64 = 0.04;

/// Standard deviation of the smoothing along curves [longest side].
const SMOOTHING: f64 = 0.012;

/// A node belongs to the plane of symmetry when it is nearer to it than this share of its radius, and so does an end when its outer half is.
const IN_PLANE: f64 = 0.45;

/// A ball of the curve skeleton.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub position: DVec3,
    /// Distance to the outside [model unit].
    pub radius: f64,
    /// Distance from the thickest place, through the solid.
    pub level: f64,
    /// Parent, always smaller than the node's own index.
    pub parent: Option<usize>,
    /// In the plane of symmetry, with all that lies between it and the thickest place. Always true without symmetry.
    pub central: bool,
}

/// The curve skeleton; of symmetric solids the half beside the plane and what lies in it.
#[derive(Clone, Debug, Default)]
pub(crate) struct MedialTree {
    pub nodes: Vec<Node>,
    /// Ends: node, and the level at which the limb meets another one.
    pub ends: Vec<(usize, f64)>,
}

impl MedialTree {
    /// Finds it; `fineness` divides the least length of a limb.
    pub fn new(solid: &Solid, longest: f64, fineness: f64, mirror: Option<&Mirror>) -> Self {
        // Of a symmetric solid the thickest place in its plane.
        let near = |c: &u32| mirror.is_none_or(|m| m.side(solid.center(*c)).abs() <= solid.grid.spacing);
        let depth = |c: u32| solid.depth[c as usize];
        let root = (0..solid.len() as u32)
            .filter(near)
            .max_by(|&a, &b| depth(a).total_cmp(&depth(b)).then(b.cmp(&a)))
            .unwrap_or(0);
        let (level, _) = solid.ways(&[(root, 0.0)], f64::INFINITY, |_, _, length| length);
        let unit = depth(root);
        let (_, before) = solid.ways(&[(root, 0.0)], f64::INFINITY, |a, b, length| {
            length * (2.0 * unit / (depth(a) + depth(b))).powf(CENTRING)
        });
        let mut tree = Growing {
            solid,
            mirror,
            node_of: vec![NONE; solid.len()],
            cells: vec![root],
            parents: vec![None],
            central: vec![true],
            ends: Vec::new(),
        };
        tree.node_of[root as usize] = 0;
        for tip in tips(solid, &level, LEAST_LENGTH * longest / fineness) {
            tree.add_way(&tip, &before);
        }
        tree.finish(longest, &level)
    }

    /// Children of every node.
    pub fn children(&self) -> Vec<Vec<usize>> {
        let mut children = vec![Vec::new(); self.nodes.len()];
        for (i, node) in self.nodes.iter().enumerate() {
            node.parent.into_iter().for_each(|p| children[p].push(i));
        }
        children
    }
}

/// The tree while it grows.
struct Growing<'a> {
    solid: &'a Solid,
    mirror: Option<&'a Mirror>,
    node_of: Vec<u32>,
    cells: Vec<u32>,
    parents: Vec<Option<usize>>,
    central: Vec<bool>,
    ends: Vec<(usize, f64)>,
}

impl Growing<'_> {
    fn add_way(&mut self, tip: &Tip, before: &[u32]) {
        let mut way = Vec::new();
        let mut at = tip.cell;
        while self.node_of[at as usize] == NONE {
            way.push(at);
            at = before[at as usize];
            if at == NONE {
                return;
            }
        }
        let (lean, width) = self.lean(&way);
        let middle = lean.abs() < IN_PLANE * width + self.solid.grid.spacing;
        if !middle && lean < 0.0 {
            // Its image is there, or was.
            return;
        }
        let mut parent = self.node_of[at as usize] as usize;
        if middle {
            // What a central way hangs on is central as well.
            let mut up = Some(parent);
            while let Some(k) = up {
                self.central[k] = true;
                up = self.parents[k];
            }
        }
        for &cell in way.iter().rev() {
            let near = self
                .mirror
                .is_none_or(|m| m.side(self.solid.center(cell)).abs() < IN_PLANE * self.solid.depth[cell as usize]);
            self.node_of[cell as usize] = self.cells.len() as u32;
            self.central.push(middle || (self.central[parent] && near));
            self.parents.push(Some(parent));
            parent = self.cells.len();
            self.cells.push(cell);
        }
        self.ends.push((parent, tip.meets));
    }

    /// Mean signed distance of a way's outer half from the plane, and its mean depth; zero without a plane.
    fn lean(&self, way: &[u32]) -> (f64, f64) {
        let (Some(m), false) = (self.mirror, way.is_empty()) else { return (0.0, 1.0) };
        let outer = &way[..way.len().div_ceil(2)];
        let mean = |f: &dyn Fn(u32) -> f64| outer.iter().map(|&c| f(c)).sum::<f64>() / outer.len() as f64;
        (mean(&|c| m.side(self.solid.center(c))), mean(&|c| self.solid.depth[c as usize]))
    }

    fn finish(self, longest: f64, level: &[f64]) -> MedialTree {
        let place = |c: u32, central: bool| match self.mirror {
            Some(m) if central => m.flattened(self.solid.center(c)),
            _ => self.solid.center(c),
        };
        let nodes: Vec<Node> = (0..self.cells.len())
            .map(|k| Node {
                position: place(self.cells[k], self.central[k]),
                radius: self.solid.depth[self.cells[k] as usize],
                level: level[self.cells[k] as usize],
                parent: self.parents[k],
                central: self.central[k],
            })
            .collect();
        let mut tree = MedialTree { nodes, ends: self.ends };
        // A walk of n half steps spreads by √(n/2) cells.
        let sweeps = (2.0 * (SMOOTHING * longest / self.solid.grid.spacing).powi(2)).ceil() as usize;
        smooth(&mut tree, sweeps);
        tree
    }
}

/// Moves nodes with two neighbours towards the middle between them; tips and branchings stay.
fn smooth(tree: &mut MedialTree, sweeps: usize) {
    let children = tree.children();
    for _ in 0..sweeps {
        let old: Vec<DVec3> = tree.nodes.iter().map(|n| n.position).collect();
        for (k, node) in tree.nodes.iter_mut().enumerate() {
            let (Some(p), [c]) = (node.parent, &children[k][..]) else { continue };
            node.position = 0.5 * old[k] + 0.25 * (old[p] + old[*c]);
        }
    }
}

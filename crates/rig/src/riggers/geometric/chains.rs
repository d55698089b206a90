//! The curve skeleton cut into chains: a trunk, limbs on the trunk, and what grows on limbs.

use super::medial::MedialTree;
use super::symmetry::Mirror;
use glam::DVec3;

/// A branch counts if it is this many times as long, from where it comes out, as it is thick (radius) there.
const LEAST_SLENDERNESS: f64 = 0.9;

/// Without an exactly symmetric pose a tip that has no partner on the other side is central when it is nearer to the plane than this many
/// times the thickest ball's radius.
const NEAR_PLANE: f64 = 1.2;

/// Two tips are partners if their ways differ in length and distance from the plane by less than this, both relative, and the tips
/// themselves, mirrored, in place [longest side], counted so much, together; and if they are not both in the plane [longest side].
const PARTNERS: f64 = 0.8;
const APART: f64 = 0.7;
const BESIDE: f64 = 0.05;

/// A way from tip to tip.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    /// Nodes from the base outwards; the trunk from tail to head.
    pub nodes: Vec<usize>,
    /// Chain and place in it where this one grows; `None` for the trunk.
    pub parent: Option<(usize, usize)>,
    /// First place in `nodes` outside what it grows on.
    pub exit: usize,
}

/// The pruned curve skeleton as an undirected tree.
pub(crate) struct Graph<'a> {
    pub tree: &'a MedialTree,
    pub longest: f64,
    neighbours: Vec<Vec<usize>>,
    /// Level at which a tip's limb meets another \[node\].
    meets: Vec<f64>,
}

impl<'a> Graph<'a> {
    /// Prunes.
    pub fn new(tree: &'a MedialTree, longest: f64) -> Self {
        let mut alive = vec![true; tree.nodes.len()];
        let mut meets = vec![0.0; tree.nodes.len()];
        tree.ends.iter().for_each(|e| meets[e.0] = e.1);
        loop {
            let children = living_children(tree, &alive);
            let tips = (1..alive.len()).filter(|&k| alive[k] && children[k].is_empty());
            let weakest = tips
                .map(|tip| branch(tree, &children, tip))
                .map(|b| (slenderness(tree, &b, meets[b[0]]), b))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            match weakest {
                Some((s, b)) if s < LEAST_SLENDERNESS => b[..b.len() - 1].iter().for_each(|&k| alive[k] = false),
                _ => break,
            }
        }
        let mut neighbours = vec![Vec::new(); alive.len()];
        for (k, node) in tree.nodes.iter().enumerate() {
            if let (true, Some(p)) = (alive[k], node.parent) {
                neighbours[k].push(p);
                neighbours[p].push(k);
            }
        }
        Self { tree, longest, neighbours, meets }
    }

    /// Where a node is.
    pub fn at(&self, k: usize) -> DVec3 {
        self.tree.nodes[k].position
    }

    /// Its radius.
    pub fn radius(&self, k: usize) -> f64 {
        self.tree.nodes[k].radius
    }

    /// Ends of the tree; its only node if there is one alone.
    pub fn tips(&self) -> Vec<usize> {
        let ends: Vec<usize> = (0..self.neighbours.len()).filter(|&k| self.neighbours[k].len() == 1).collect();
        if ends.is_empty() { vec![0] } else { ends }
    }

    /// Parents when the tree hangs on `root`, and the length of the way to it \[node\]; infinite for pruned nodes.
    fn hang(&self, root: usize) -> (Vec<usize>, Vec<f64>) {
        let mut parent = vec![usize::MAX; self.neighbours.len()];
        let mut length = vec![f64::INFINITY; self.neighbours.len()];
        length[root] = 0.0;
        let mut stack = vec![root];
        while let Some(k) = stack.pop() {
            let up = parent[k];
            for &n in self.neighbours[k].iter().filter(|&&n| n != up) {
                parent[n] = k;
                length[n] = length[k] + self.at(k).distance(self.at(n));
                stack.push(n);
            }
        }
        (parent, length)
    }

    /// The nodes between two, both included.
    pub fn way(&self, from: usize, to: usize) -> Vec<usize> {
        let (parent, _) = self.hang(from);
        let mut out = vec![to];
        while out[out.len() - 1] != from {
            out.push(parent[out[out.len() - 1]]);
        }
        out.reverse();
        out
    }

    /// ∫ radius ds.
    fn substance(&self, way: &[usize]) -> f64 {
        way.windows(2)
            .map(|w| self.at(w[0]).distance(self.at(w[1])) * (self.radius(w[0]) + self.radius(w[1])) / 2.0)
            .sum()
    }

    /// Length of a polyline of nodes.
    pub fn length(&self, way: &[usize]) -> f64 {
        way.windows(2).map(|w| self.at(w[0]).distance(self.at(w[1]))).sum()
    }

    /// The trunk: the most substantial way between two ends of the middle.
    pub fn trunk(&self, mirror: Option<&Mirror>) -> Vec<usize> {
        let ends = self.central_ends(mirror);
        let mut best: (f64, Vec<usize>) = (-1.0, vec![ends[0]]);
        for (i, &a) in ends.iter().enumerate() {
            for &b in &ends[i + 1..] {
                let way = self.way(a, b);
                let s = self.substance(&way);
                if s > best.0 {
                    best = (s, way);
                }
            }
        }
        best.1
    }

    fn central_ends(&self, mirror: Option<&Mirror>) -> Vec<usize> {
        let tips = self.tips();
        let Some(mirror) = mirror else { return tips };
        if mirror.exact {
            let alive = |k: &usize| !self.neighbours[*k].is_empty() && self.tree.nodes[*k].central;
            let end = |k: &usize| self.neighbours[*k].iter().filter(|&&n| self.tree.nodes[n].central).count() <= 1;
            let ends: Vec<usize> = (0..self.neighbours.len()).filter(|k| alive(k) && end(k)).collect();
            return if ends.is_empty() { tips[..1].to_vec() } else { ends };
        }
        let thickest = (0..self.neighbours.len()).map(|k| self.radius(k)).fold(0.0, f64::max);
        let pairs = self.partners(&tips, mirror);
        let single = |t: &usize| !pairs.iter().any(|p| p.contains(t));
        let near = |t: &usize| mirror.side(self.at(*t)).abs() < NEAR_PLANE * thickest;
        let mut ends: Vec<usize> = tips.iter().copied().filter(|t| single(t) && near(t)).collect();
        // A body may end in its thickest place, a round head, and where a pair of limbs parts.
        ends.push(0);
        ends.extend(pairs.iter().map(|&[a, b]| self.fork(a, b)));
        ends.sort_unstable();
        ends.dedup();
        ends
    }

    /// Pairs of tips on either side of the plane that are alike, the most alike first.
    fn partners(&self, tips: &[usize], mirror: &Mirror) -> Vec<[usize; 2]> {
        let level = |k: usize| self.tree.nodes[k].level;
        let side = |k: usize| mirror.side(self.at(k));
        let mut likely: Vec<(f64, [usize; 2])> = Vec::new();
        for (i, &a) in tips.iter().enumerate() {
            for &b in &tips[i + 1..] {
                let lengths = (level(a) - level(b)).abs() / level(a).max(level(b));
                let sides = (side(a) + side(b)).abs() / (side(a).abs() + side(b).abs() + 0.05 * self.longest);
                let apart = APART * mirror.image(self.at(a)).distance(self.at(b)) / self.longest;
                if side(a).abs() + side(b).abs() < BESIDE * self.longest {
                    continue;
                }
                likely.push((lengths + sides + apart, [a, b]));
            }
        }
        likely.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut pairs: Vec<[usize; 2]> = Vec::new();
        for (unlike, pair) in likely {
            if unlike < PARTNERS && !pairs.iter().flatten().any(|k| pair.contains(k)) {
                pairs.push(pair);
            }
        }
        pairs
    }

    /// Where the ways from the root to two nodes part.
    fn fork(&self, a: usize, b: usize) -> usize {
        let (a, b) = (self.way(0, a), self.way(0, b));
        a.iter().zip(&b).take_while(|(p, q)| p == q).last().map_or(0, |p| *p.0)
    }

    /// All chains: the trunk as given, then from each the longest ways into what still hangs on it.
    pub fn chains(&self, trunk: Vec<usize>) -> Vec<Chain> {
        let (parent, length) = self.hang(trunk[0]);
        let mut taken = vec![false; parent.len()];
        trunk.iter().for_each(|&k| taken[k] = true);
        let mut chains = vec![Chain { nodes: trunk, parent: None, exit: 0 }];
        let mut tips: Vec<usize> = self.tips().into_iter().filter(|&t| !taken[t]).collect();
        tips.sort_by(|&a, &b| length[b].total_cmp(&length[a]).then(a.cmp(&b)));
        for tip in tips {
            let mut nodes = vec![tip];
            while !taken[nodes[nodes.len() - 1]] {
                nodes.push(parent[nodes[nodes.len() - 1]]);
            }
            let base = nodes[nodes.len() - 1];
            nodes.iter().for_each(|&k| taken[k] = true);
            nodes.reverse();
            let owner = chains.iter().enumerate().find_map(|(c, chain)| {
                chain
                    .nodes
                    .iter()
                    .skip(usize::from(c > 0))
                    .position(|&k| k == base)
                    .map(|i| (c, i + usize::from(c > 0)))
            });
            let Some(mut owner) = owner else { continue };
            // What parts from a limb before that comes out of the trunk is a limb of the trunk itself.
            while let Some(above) = chains[owner.0].parent.filter(|_| owner.1 < chains[owner.0].exit) {
                owner = above;
            }
            let exit = self.exit(&nodes, &chains[owner.0].nodes);
            chains.push(Chain { nodes, parent: Some(owner), exit });
        }
        chains
    }

    /// First place of a branch that is outside of the chain it grows on and beyond the level at which it meets other limbs.
    fn exit(&self, branch: &[usize], on: &[usize]) -> usize {
        let meets = self.meets[branch[branch.len() - 1]];
        let inside = |k: usize| {
            self.tree.nodes[k].level < meets
                || on.iter().any(|&q| self.at(k).distance(self.at(q)) < 0.7 * self.radius(q))
        };
        let last = branch.iter().rposition(|&k| inside(k)).unwrap_or(0);
        (last + 1).min(branch.len() - 1)
    }
}

fn living_children(tree: &MedialTree, alive: &[bool]) -> Vec<Vec<usize>> {
    let mut children = tree.children();
    children.iter_mut().for_each(|c| c.retain(|&k| alive[k]));
    children
}

/// A tip's nodes down to the branching (or root) that it grows on, that one last.
fn branch(tree: &MedialTree, children: &[Vec<usize>], tip: usize) -> Vec<usize> {
    let mut nodes = vec![tip];
    while let Some(p) = tree.nodes[nodes[nodes.len() - 1]].parent {
        nodes.push(p);
        if children[p].len() > 1 {
            break;
        }
    }
    nodes
}

/// Length of a branch beyond the level at which it meets another, over its usual radius there.
fn slenderness(tree: &MedialTree, branch: &[usize], meets: f64) -> f64 {
    let out = branch.iter().position(|&k| tree.nodes[k].level <= meets).unwrap_or(branch.len()).max(1);
    let length = tree.nodes[branch[0]].level - meets.max(tree.nodes[branch[branch.len() - 1]].level);
    let mut widths: Vec<f64> = branch[..out].iter().map(|&k| tree.nodes[k].radius).collect();
    widths.sort_by(f64::total_cmp);
    length / widths[widths.len() / 2]
}

//! Minimum cuts by augmenting paths (Boykov, Kolmogorov: An Experimental Comparison of Min-Cut/Max-Flow Algorithms for
//! Energy Minimization in Vision, TPAMI 2004, §3).
//!
//! Two search trees grow from source and sink; where they touch, flow is pushed; nodes cut off from their tree look for a
//! new parent. Capacities are integers, so that the cut is exact and the same everywhere.

use std::collections::VecDeque;

/// No parent: the node is in neither tree.
const FREE: u32 = u32::MAX;
/// The parent is the terminal itself.
const TERMINAL: u32 = u32::MAX - 1;
/// The parent was lost.
const ORPHAN: u32 = u32::MAX - 2;

/// A graph with two terminals. Edges hold the same capacity both ways.
pub(super) struct Graph {
    /// First arc of each node, and the end.
    first: Vec<u32>,
    head: Vec<u32>,
    sister: Vec<u32>,
    residual: Vec<i32>,
    /// Residual to the terminals: positive from the source, negative to the sink.
    terminal: Vec<i32>,
    parent: Vec<u32>,
    in_sink_tree: Vec<bool>,
    distance: Vec<u32>,
    stamp: Vec<u32>,
    queued: Vec<bool>,
    active: VecDeque<u32>,
    orphans: VecDeque<u32>,
    time: u32,
}

impl Graph {
    /// `terminal`: pull to the source (positive) or the sink (negative) \[node\]. `edges`: two nodes and the capacity.
    pub fn new(terminal: Vec<i32>, edges: &[(u32, u32, i32)]) -> Self {
        let n = terminal.len();
        let mut first = vec![0u32; n + 1];
        for &(a, b, _) in edges {
            first[a as usize + 1] += 1;
            first[b as usize + 1] += 1;
        }
        for i in 0..n {
            first[i + 1] += first[i];
        }
        let mut next = first.clone();
        let arcs = 2 * edges.len();
        let (mut head, mut sister, mut residual) = (vec![0; arcs], vec![0; arcs], vec![0; arcs]);
        for &(a, b, capacity) in edges {
            let (i, j) = (next[a as usize], next[b as usize]);
            next[a as usize] += 1;
            next[b as usize] += 1;
            (head[i as usize], sister[i as usize], residual[i as usize]) = (b, j, capacity);
            (head[j as usize], sister[j as usize], residual[j as usize]) = (a, i, capacity);
        }
        Self {
            first,
            head,
            sister,
            residual,
            terminal,
            parent: vec![FREE; n],
            in_sink_tree: vec![false; n],
            distance: vec![0; n],
            stamp: vec![0; n],
            queued: vec![false; n],
            active: VecDeque::new(),
            orphans: VecDeque::new(),
            time: 0,
        }
    }

    /// Which nodes lie on the source's side of a minimum cut.
    pub fn source_side(mut self) -> Vec<bool> {
        for i in 0..self.terminal.len() {
            if self.terminal[i] != 0 {
                self.in_sink_tree[i] = self.terminal[i] < 0;
                self.parent[i] = TERMINAL;
                self.distance[i] = 1;
                self.activate(i as u32);
            }
        }
        while let Some(i) = self.active.pop_front() {
            self.queued[i as usize] = false;
            // A node stays active until it touches the other tree no more.
            while self.parent[i as usize] != FREE {
                let Some(bridge) = self.grow(i) else { break };
                self.time += 1;
                self.augment(bridge);
                self.adopt();
            }
        }
        (0..self.parent.len()).map(|i| self.parent[i] != FREE && !self.in_sink_tree[i]).collect()
    }

    fn activate(&mut self, i: u32) {
        if !self.queued[i as usize] {
            self.queued[i as usize] = true;
            self.active.push_back(i);
        }
    }

    fn arcs(&self, i: u32) -> std::ops::Range<u32> {
        self.first[i as usize]..self.first[i as usize + 1]
    }

    /// Residual of arc `a` in the direction in which the tree of its tail pushes.
    fn open(&self, a: u32, in_sink_tree: bool) -> bool {
        let a = if in_sink_tree { self.sister[a as usize] } else { a };
        self.residual[a as usize] > 0
    }

    /// Takes free neighbours of `i` into its tree; an arc from the source's tree to the sink's where they touch.
    fn grow(&mut self, i: u32) -> Option<u32> {
        let side = self.in_sink_tree[i as usize];
        for a in self.arcs(i) {
            if !self.open(a, side) {
                continue;
            }
            let j = self.head[a as usize];
            let (iu, ju) = (i as usize, j as usize);
            if self.parent[ju] == FREE {
                self.in_sink_tree[ju] = side;
                self.adopt_by(ju, self.sister[a as usize], iu);
                self.activate(j);
            } else if self.in_sink_tree[ju] != side {
                return Some(if side { self.sister[a as usize] } else { a });
            } else if self.stamp[ju] <= self.stamp[iu] && self.distance[ju] > self.distance[iu] {
                // A shorter way to the terminal keeps the trees flat.
                self.adopt_by(ju, self.sister[a as usize], iu);
            }
        }
        None
    }

    fn adopt_by(&mut self, child: usize, arc_to_parent: u32, parent: usize) {
        self.parent[child] = arc_to_parent;
        self.stamp[child] = self.stamp[parent];
        self.distance[child] = self.distance[parent] + 1;
    }

    /// Pushes what fits along the path through `bridge` (from the source's tree to the sink's).
    fn augment(&mut self, bridge: u32) {
        let ends = [self.head[self.sister[bridge as usize] as usize], self.head[bridge as usize]];
        let mut flow = self.residual[bridge as usize];
        for (side, &end) in ends.iter().enumerate() {
            let mut i = end as usize;
            while self.parent[i] != TERMINAL {
                let to_parent = self.parent[i] as usize;
                let arc = if side == 0 { self.sister[to_parent] as usize } else { to_parent };
                flow = flow.min(self.residual[arc]);
                i = self.head[to_parent] as usize;
            }
            flow = flow.min(self.terminal[i].abs());
        }
        self.residual[bridge as usize] -= flow;
        self.residual[self.sister[bridge as usize] as usize] += flow;
        for (side, &end) in ends.iter().enumerate() {
            let mut i = end as usize;
            while self.parent[i] != TERMINAL {
                let to_parent = self.parent[i] as usize;
                let arc = if side == 0 { self.sister[to_parent] as usize } else { to_parent };
                self.residual[arc] -= flow;
                self.residual[self.sister[arc] as usize] += flow;
                let above = self.head[to_parent] as usize;
                if self.residual[arc] == 0 {
                    self.parent[i] = ORPHAN;
                    self.orphans.push_front(i as u32);
                }
                i = above;
            }
            self.terminal[i] -= if side == 0 { flow } else { -flow };
            if self.terminal[i] == 0 {
                self.parent[i] = ORPHAN;
                self.orphans.push_front(i as u32);
            }
        }
    }

    /// Distance of `j` to its terminal, if its chain of parents still ends there; marks the chain as checked.
    fn rooted(&mut self, j: usize) -> Option<u32> {
        let (mut k, mut steps) = (j, 0);
        let total = loop {
            if self.stamp[k] == self.time {
                break steps + self.distance[k];
            }
            steps += 1;
            match self.parent[k] {
                TERMINAL => {
                    self.stamp[k] = self.time;
                    self.distance[k] = 1;
                    break steps;
                }
                ORPHAN | FREE => return None,
                arc => k = self.head[arc as usize] as usize,
            }
        };
        let (mut k, mut d) = (j, total);
        while self.stamp[k] != self.time {
            self.stamp[k] = self.time;
            self.distance[k] = d;
            d -= 1;
            k = self.head[self.parent[k] as usize] as usize;
        }
        Some(total)
    }

    /// Finds new parents for orphans, or sets them free.
    fn adopt(&mut self) {
        while let Some(i) = self.orphans.pop_front() {
            let iu = i as usize;
            let side = self.in_sink_tree[iu];
            let mut best: Option<(u32, u32)> = None;
            for a in self.arcs(i) {
                let j = self.head[a as usize] as usize;
                let towards = self.sister[a as usize];
                if self.in_sink_tree[j] != side || self.parent[j] == FREE || !self.open(towards, side) {
                    continue;
                }
                if let Some(d) = self.rooted(j).filter(|&d| best.is_none_or(|b| d < b.0)) {
                    best = Some((d, a));
                }
            }
            if let Some((d, arc)) = best {
                self.parent[iu] = arc;
                self.stamp[iu] = self.time;
                self.distance[iu] = d + 1;
                continue;
            }
            self.parent[iu] = FREE;
            for a in self.arcs(i) {
                let j = self.head[a as usize];
                let ju = j as usize;
                if self.in_sink_tree[ju] != side || self.parent[ju] == FREE {
                    continue;
                }
                if self.open(self.sister[a as usize], side) {
                    self.activate(j);
                }
                let p = self.parent[ju];
                if p != TERMINAL && p != ORPHAN && self.head[p as usize] == i {
                    self.parent[ju] = ORPHAN;
                    self.orphans.push_back(j);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn energy(terminal: &[i32], edges: &[(u32, u32, i32)], source: &[bool]) -> i64 {
        let pull = |(i, &t): (usize, &i32)| i64::from(if source[i] { (-t).max(0) } else { t.max(0) });
        let unary: i64 = terminal.iter().enumerate().map(pull).sum();
        let cut = |&&(a, b, _): &&(u32, u32, i32)| source[a as usize] != source[b as usize];
        unary + edges.iter().filter(cut).map(|e| i64::from(e.2)).sum::<i64>()
    }

    #[test]
    fn cuts_of_random_grids_are_as_cheap_as_the_best_of_all_labellings() {
        let (w, h) = (4usize, 4usize);
        let mut state = 3u64;
        let mut random = move |n: i32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % n as u64) as i32
        };
        for round in 0..40 {
            let terminal: Vec<i32> = (0..w * h).map(|_| random(21) - 10).collect();
            let mut edges = Vec::new();
            for i in 0..w * h {
                let (x, y) = (i % w, i / w);
                for (dx, dy) in [(1, 0), (0, 1), (1, 1)] {
                    if x + dx < w && y + dy < h {
                        edges.push((i as u32, (i + dy * w + dx) as u32, random(9)));
                    }
                }
            }
            let best = (0u32..1 << (w * h))
                .map(|bits| (0..w * h).map(|i| bits >> i & 1 == 1).collect::<Vec<bool>>())
                .map(|labels| energy(&terminal, &edges, &labels))
                .min();
            let found = energy(&terminal, &edges, &Graph::new(terminal.clone(), &edges).source_side());
            assert_eq!(Some(found), best, "round {round}");
        }
    }
}

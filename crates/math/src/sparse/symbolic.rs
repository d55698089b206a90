//! Symbolic analysis: the supernodes of the multifrontal factorisation, found once per pattern.
//!
//! A supernode is a separator of the dissection (small ones merged into their parents): its points are eliminated together
//! as a dense *front* whose rows are those points, padded to whole strips, followed by the later points they touch.

use super::block_matrix::BlockPattern;
use super::dissection::Dissection;
use super::parts::{self, Part};

/// Points per strip: fronts are stored in strips of 12 scalar rows.
pub const STRIP_POINTS: usize = 4;

/// One dense front.
#[derive(Clone, Debug, Default)]
pub struct Supernode {
    /// First position it eliminates.
    pub start: usize,
    /// Positions it eliminates.
    pub pivots: usize,
    /// Later positions it touches, ascending.
    pub rows: Vec<u32>,
    /// Child supernodes, ascending.
    pub children: Vec<u32>,
    /// First supernode of its subtree; the subtree is `first..=self` because of postorder.
    pub first: usize,
    /// For each of `rows`: its place in the parent's front (in points).
    pub place_in_parent: Vec<u32>,
    /// Floating-point operations of the whole subtree.
    pub subtree_flops: f64,
}

impl Supernode {
    /// Strips of pivot rows.
    pub fn pivot_strips(&self) -> usize {
        self.pivots.div_ceil(STRIP_POINTS)
    }

    /// Strips of rows below the pivots.
    pub fn update_strips(&self) -> usize {
        self.rows.len().div_ceil(STRIP_POINTS)
    }

    /// Place (in points) in this front of a position at or after `start`, if it is there.
    fn place(&self, position: u32) -> Option<u32> {
        match (position as usize).checked_sub(self.start) {
            Some(k) if k < self.pivots => Some(k as u32),
            _ => {
                let k = self.rows.binary_search(&position).ok()?;
                Some((self.pivot_strips() * STRIP_POINTS + k) as u32)
            }
        }
    }
}

/// The supernodes of a pattern, in postorder.
#[derive(Clone, Debug, Default)]
pub struct Symbolic {
    /// Supernodes, children before parents.
    pub supernodes: Vec<Supernode>,
    /// Supernodes without parent.
    pub roots: Vec<u32>,
    /// For every block of the pattern: its row's place (in points) in the front that eliminates its column.
    pub block_place: Vec<u32>,
    /// Block columns of the matrix.
    pub columns: usize,
    /// Subtrees that solves and products go through in parallel.
    pub parts: Vec<Part>,
}

/// Nanoseconds a front of `p` pivots and `r` rows is expected to take: arithmetic, traffic of the update matrix, start-up.
/// Only ratios matter: it decides which small fronts to merge.
fn front_cost(p: usize, r: usize) -> f64 {
    let (m, n) = ((3 * p.next_multiple_of(STRIP_POINTS)) as f64, (3 * r) as f64);
    flops(p, r) / 25.0 + 0.9 * n * n / 2.0 + 0.3 * m * n + 600.0
}

/// Floating-point operations of a front with `p` pivot points and `r` rows below.
fn flops(p: usize, r: usize) -> f64 {
    let (m, n) = ((3 * p.next_multiple_of(STRIP_POINTS)) as f64, (3 * r.next_multiple_of(STRIP_POINTS)) as f64);
    m * m * m / 3.0 + m * m * n + m * n * n
}

impl Symbolic {
    /// Analyses a pattern whose positions follow the dissection's order.
    pub fn new(pattern: &BlockPattern, dissection: &Dissection) -> Self {
        let (supernodes, roots) = merge_small(pattern, dissection);
        let mut symbolic = Self { supernodes, roots, columns: pattern.columns(), ..Self::default() };
        symbolic.link();
        symbolic.parts = parts::independent(&symbolic.supernodes, &symbolic.roots);
        symbolic.block_place = vec![0; pattern.row.len()];
        for node in &symbolic.supernodes {
            for column in node.start..node.start + node.pivots {
                for k in pattern.column(column) {
                    symbolic.block_place[k] = node.place(pattern.row[k]).expect("structure covers the pattern");
                }
            }
        }
        symbolic
    }

    /// Numbers stored in the factor.
    pub fn factor_entries(&self) -> usize {
        self.supernodes.iter().map(|s| super::front::panel_len(s.pivot_strips(), s.update_strips())).sum()
    }

    /// Floating-point operations of one factorisation.
    pub fn factor_flops(&self) -> f64 {
        self.roots.iter().map(|&r| self.supernodes[r as usize].subtree_flops).sum()
    }

    /// Fills places in parents, subtree ranges and costs.
    fn link(&mut self) {
        for s in 0..self.supernodes.len() {
            let children = std::mem::take(&mut self.supernodes[s].children);
            let mut cost = flops(self.supernodes[s].pivots, self.supernodes[s].rows.len());
            self.supernodes[s].first = children.first().map_or(s, |&c| self.supernodes[c as usize].first);
            for &c in &children {
                let parent = &self.supernodes[s];
                let place = |row: &u32| parent.place(*row).expect("rows of a child are in its parent");
                let places = self.supernodes[c as usize].rows.iter().map(place).collect();
                self.supernodes[c as usize].place_in_parent = places;
                cost += self.supernodes[c as usize].subtree_flops;
            }
            self.supernodes[s].children = children;
            self.supernodes[s].subtree_flops = cost;
        }
    }
}

/// Supernodes with rows and children, and the roots, after merging children into parents where the cost model says it pays.
///
/// Only the child eliminated just before its parent can be merged, so that pivots stay contiguous.
fn merge_small(pattern: &BlockPattern, dissection: &Dissection) -> (Vec<Supernode>, Vec<u32>) {
    let mut subtree_start: Vec<u32> = dissection.nodes.iter().map(|n| n.start).collect();
    let (mut done, mut open): (Vec<Supernode>, Vec<u32>) = (vec![], vec![]);
    for (n, node) in dissection.nodes.iter().enumerate() {
        if let Some(p) = node.parent {
            subtree_start[p as usize] = subtree_start[p as usize].min(subtree_start[n]);
        }
        if node.start == node.end {
            continue; // an empty separator: its parts hang on the next ancestor
        }
        let first_child = open.partition_point(|&c| done[c as usize].start < subtree_start[n] as usize);
        let mut own = Supernode { start: node.start as usize, ..Supernode::default() };
        own.pivots = node.end as usize - own.start;
        own.children = open.split_off(first_child);
        let columns = own.start..node.end as usize;
        own.rows = columns.flat_map(|j| pattern.row[pattern.column(j)].iter().copied()).collect();
        own.children.iter().for_each(|&c| own.rows.extend(&done[c as usize].rows));
        own.rows.retain(|&r| r >= node.end);
        own.rows.sort_unstable();
        own.rows.dedup();
        while let (Some(last), Some(&child)) = (done.last(), own.children.last()) {
            let apart = front_cost(own.pivots, own.rows.len()) + front_cost(last.pivots, last.rows.len());
            let adjacent = child as usize + 1 == done.len();
            if !adjacent || front_cost(own.pivots + last.pivots, own.rows.len()) > apart {
                break;
            }
            own.start = last.start;
            own.pivots += last.pivots;
            own.children.pop();
            own.children.extend(&last.children);
            done.pop();
        }
        open.push(done.len() as u32);
        done.push(own);
    }
    (done, open)
}

//! Independent subtrees of the elimination tree, for the operations that do too little per number to be split finer.
//!
//! The cut depends on the pattern alone and sums are made in one fixed order, so results have the same bytes for any number
//! of threads.

use super::symbolic::{Supernode, Symbolic};
use rayon::prelude::*;
use std::ops::Range;

/// Trees with less work than this are left whole: about 0.1 ms of solving, some ten times what it takes to wake a thread.
const SMALLEST_TREE: f64 = 3e7;
/// A subtree is cut further while it has more than this share of the work: several a thread, so that none waits long.
const LARGEST_SHARE: f64 = 0.15;

/// A subtree: its supernodes, and the positions they eliminate.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Part {
    /// Supernodes, contiguous because of postorder.
    pub nodes: Range<usize>,
    /// Positions, contiguous too.
    pub points: Range<usize>,
}

/// Disjoint subtrees in ascending order; no two of them share an unknown or a block. Empty for small trees.
pub(super) fn independent(supernodes: &[Supernode], roots: &[u32]) -> Vec<Part> {
    let total: f64 = roots.iter().map(|&r| supernodes[r as usize].subtree_flops).sum();
    let mut open: Vec<u32> = if total > SMALLEST_TREE { roots.to_vec() } else { vec![] };
    let mut parts = vec![];
    while let Some(root) = open.pop() {
        let node = &supernodes[root as usize];
        if node.subtree_flops > LARGEST_SHARE * total && !node.children.is_empty() {
            open.extend(&node.children);
        } else {
            let points = supernodes[node.first].start..node.start + node.pivots;
            parts.push(Part { nodes: node.first..root as usize + 1, points });
        }
    }
    parts.sort_unstable_by_key(|p: &Part| p.points.start);
    parts
}

impl Symbolic {
    /// Supernodes above every part, ascending.
    pub(super) fn top(&self) -> impl DoubleEndedIterator<Item = usize> {
        let starts = std::iter::once(0).chain(self.parts.iter().map(|p| p.nodes.end));
        let ends = self.parts.iter().map(|p| p.nodes.start).chain([self.supernodes.len()]);
        starts.zip(ends).flat_map(|(a, b)| a..b).collect::<Vec<_>>().into_iter()
    }

    /// Runs `f` on every part in parallel, with the part's own entries of x.
    pub(super) fn for_parts<T: Send>(&self, x: &mut [f64], f: impl Fn(&Part, &mut [f64]) -> T + Sync + Send) -> Vec<T> {
        let mut own = Vec::with_capacity(self.parts.len());
        let (mut rest, mut at) = (x, 0);
        for part in &self.parts {
            let (_, from) = rest.split_at_mut(3 * part.points.start - at);
            let (slice, next) = from.split_at_mut(3 * part.points.len());
            own.push(slice);
            (rest, at) = (next, 3 * part.points.end);
        }
        self.parts.par_iter().zip(own).with_max_len(1).map(|(part, x)| f(part, x)).collect()
    }

    /// Runs `f` on every part in parallel, with the part's own entries of x and a zeroed copy of the entries after them;
    /// then adds what was written to the copies, in the order of the parts.
    pub(super) fn scatter_parts(&self, x: &mut [f64], f: impl Fn(&Part, &mut [f64], &mut [f64]) + Sync + Send) {
        let len = x.len();
        let after = self.for_parts(x, |part, own| {
            let mut after = vec![0.0; len - 3 * part.points.end];
            f(part, own, &mut after);
            after
        });
        for (part, after) in self.parts.iter().zip(after) {
            x[3 * part.points.end..].iter_mut().zip(after).for_each(|(x, a)| *x += a);
        }
    }
}

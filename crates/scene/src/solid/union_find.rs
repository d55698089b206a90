//! Disjoint sets with path halving; the smaller root wins, so results do not depend on the order of joins.

/// Sets of 0..n.
pub struct UnionFind {
    parent: Vec<u32>,
}

impl UnionFind {
    /// n sets of one.
    pub fn new(n: usize) -> Self {
        Self { parent: (0..n as u32).collect() }
    }

    /// The set's name.
    pub fn find(&mut self, k: usize) -> usize {
        let mut k = k as u32;
        while self.parent[k as usize] != k {
            let up = self.parent[self.parent[k as usize] as usize];
            self.parent[k as usize] = up;
            k = up;
        }
        k as usize
    }

    /// Makes two sets one.
    pub fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b)] = a.min(b) as u32;
    }

    /// Whether two are in one set.
    pub fn same(&mut self, a: usize, b: usize) -> bool {
        self.find(a) == self.find(b)
    }
}

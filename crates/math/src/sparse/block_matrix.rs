//! Symmetric matrix of 3×3 blocks, lower triangle by block columns.

use super::symbolic::Symbolic;

/// Where the blocks are: block column j holds its diagonal block first, then rows in ascending order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BlockPattern {
    /// First block of each block column; length = columns + 1.
    pub column_start: Vec<u32>,
    /// Block row of each block (≥ its column).
    pub row: Vec<u32>,
}

impl BlockPattern {
    /// Pattern of `n` points with the given undirected neighbours; `pairs` holds (row, column), row > column, any order.
    pub fn from_pairs(n: usize, pairs: &mut Vec<(u32, u32)>) -> Self {
        pairs.sort_unstable_by_key(|&(row, column)| (column, row));
        pairs.dedup();
        let mut pattern = Self { column_start: Vec::with_capacity(n + 1), row: Vec::with_capacity(n + pairs.len()) };
        let mut next = pairs.iter().peekable();
        for column in 0..n as u32 {
            pattern.column_start.push(pattern.row.len() as u32);
            pattern.row.push(column);
            while let Some(&(row, _)) = next.next_if(|p| p.1 == column) {
                pattern.row.push(row);
            }
        }
        pattern.column_start.push(pattern.row.len() as u32);
        pattern
    }

    /// Block columns.
    pub fn columns(&self) -> usize {
        self.column_start.len().saturating_sub(1)
    }

    /// Blocks of one column.
    pub fn column(&self, j: usize) -> std::ops::Range<usize> {
        self.column_start[j] as usize..self.column_start[j + 1] as usize
    }

    /// Index of the block (row, column), row ≥ column, if it is in the pattern.
    pub fn find(&self, row: u32, column: u32) -> Option<usize> {
        let range = self.column(column as usize);
        self.row[range.clone()].binary_search(&row).ok().map(|k| range.start + k)
    }
}

/// Values on a pattern; blocks row-major, only the lower half of a diagonal block is significant.
#[derive(Clone, Debug, Default)]
pub struct BlockMatrix {
    /// The pattern.
    pub pattern: BlockPattern,
    /// One block per pattern entry, row-major.
    pub blocks: Vec<[f64; 9]>,
}

impl BlockMatrix {
    /// Zeros on a pattern.
    pub fn zeros(pattern: BlockPattern) -> Self {
        let blocks = vec![[0.0; 9]; pattern.row.len()];
        Self { pattern, blocks }
    }

    /// y = A x for the symmetric matrix; x and y have 3 entries per block column.
    pub fn times(&self, x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        (0..self.pattern.columns()).for_each(|j| self.add_column(j, x, y, 0, &mut []));
    }

    /// [`BlockMatrix::times`] through the parts of the pattern's analysis in parallel. Sums are made in another order.
    pub fn times_in_parts(&self, symbolic: &Symbolic, x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        symbolic.scatter_parts(y, |part, own, after| {
            part.points.clone().for_each(|j| self.add_column(j, x, own, part.points.start, after));
        });
        let nodes = symbolic.top().map(|s| &symbolic.supernodes[s]);
        nodes.flat_map(|n| n.start..n.start + n.pivots).for_each(|j| self.add_column(j, x, y, 0, &mut []));
    }

    /// Adds column j's share, both triangles, to y, which starts at position `first` and goes on in `after`.
    #[inline(always)]
    fn add_column(&self, j: usize, x: &[f64], y: &mut [f64], first: usize, after: &mut [f64]) {
        let range = self.pattern.column(j);
        let xj = [x[3 * j], x[3 * j + 1], x[3 * j + 2]];
        let d = &self.blocks[range.start];
        let mut yj = [
            d[0] * xj[0] + d[3] * xj[1] + d[6] * xj[2],
            d[3] * xj[0] + d[4] * xj[1] + d[7] * xj[2],
            d[6] * xj[0] + d[7] * xj[1] + d[8] * xj[2],
        ];
        for k in range.start + 1..range.end {
            let i = 3 * self.pattern.row[k] as usize;
            let b = &self.blocks[k];
            let xi = [x[i], x[i + 1], x[i + 2]];
            let at = i - 3 * first;
            let target = match at.checked_sub(y.len()) {
                None => &mut y[at..at + 3],
                Some(at) => &mut after[at..at + 3],
            };
            for c in 0..3 {
                target[c] += b[3 * c] * xj[0] + b[3 * c + 1] * xj[1] + b[3 * c + 2] * xj[2];
                yj[c] += b[c] * xi[0] + b[3 + c] * xi[1] + b[6 + c] * xi[2];
            }
        }
        let own = 3 * (j - first);
        (0..3).for_each(|c| y[own + c] += yj[c]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_product_uses_both_triangles() {
        let pattern = BlockPattern::from_pairs(2, &mut vec![(1, 0), (1, 0)]);
        assert_eq!((pattern.column_start.as_slice(), pattern.row.as_slice()), (&[0, 2, 3][..], &[0, 1, 1][..]));
        assert_eq!((pattern.find(1, 0), pattern.find(1, 1)), (Some(1), Some(2)));
        let mut a = BlockMatrix::zeros(pattern);
        a.blocks[0] = [2.0, f64::NAN, f64::NAN, 1.0, 2.0, f64::NAN, 0.0, 0.0, 2.0];
        a.blocks[1] = [0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        a.blocks[2] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let mut y = [0.0; 6];
        a.times(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &mut y);
        assert_eq!(y, [4.0, 25.0, 6.0, 14.0, 5.0, 6.0]);
    }
}

//! Multifrontal Cholesky factorisation A + diag(shift) = L Lᵀ on a fixed symbolic analysis.
//!
//! Duff & Reid 1983: each supernode assembles its columns of A and its children's update matrices into a dense front,
//! factors its pivots and hands the rest to its parent. Subtrees run in parallel; every sum has one fixed order, so the
//! factor has the same bytes for any number of threads.

use super::block_matrix::BlockMatrix;
use super::front::{self, STRIP, panel_len, panel_offset, triangle_offset};
use super::symbolic::{STRIP_POINTS, Supernode, Symbolic};

/// Subtrees with less work than this are factored by one thread.
const PARALLEL_FLOPS: f64 = 2e6;

/// The matrix has a pivot that is not positive: it is indefinite, singular, or not finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not positive definite: pivot of point {position}, coordinate {coordinate}")]
pub struct NotPositiveDefinite {
    /// Position (in elimination order) of the failing point.
    pub position: usize,
    /// Coordinate 0..3.
    pub coordinate: usize,
}

/// The factor L, one panel of strips per supernode; reused by every factorisation of one pattern.
#[derive(Clone, Debug, Default)]
pub struct Factor {
    pub(super) panels: Vec<Vec<f64>>,
}

impl Factor {
    /// Factors `matrix` + diag(shift) (one shift per point, on its three coordinates; empty = none).
    pub fn factor(
        &mut self,
        symbolic: &Symbolic,
        matrix: &BlockMatrix,
        shift: &[f64],
    ) -> Result<(), NotPositiveDefinite> {
        if self.panels.is_empty() {
            let len = |s: &Supernode| panel_len(s.pivot_strips(), s.update_strips());
            self.panels = symbolic.supernodes.iter().map(|s| vec![0.0; len(s)]).collect();
        }
        let task = Task { symbolic, matrix, shift };
        task.siblings(&symbolic.roots, 0, &mut self.panels).map(|_| ())
    }

    /// Bytes the factor occupies.
    pub fn bytes(&self) -> usize {
        self.panels.iter().map(|p| 8 * p.len()).sum()
    }
}

struct Task<'a> {
    symbolic: &'a Symbolic,
    matrix: &'a BlockMatrix,
    shift: &'a [f64],
}

type Update = Vec<f64>;

impl Task<'_> {
    /// Update matrices of subtrees with ascending, contiguous supernode ranges; `panels[0]` belongs to supernode `first`.
    fn siblings(
        &self,
        nodes: &[u32],
        first: usize,
        panels: &mut [Vec<f64>],
    ) -> Result<Vec<Update>, NotPositiveDefinite> {
        let work = |n: &u32| self.symbolic.supernodes[*n as usize].subtree_flops;
        if nodes.len() < 2 || nodes.iter().filter(|n| work(n) > PARALLEL_FLOPS).count() < 2 {
            let mut updates = Vec::with_capacity(nodes.len());
            let (mut rest, mut at) = (panels, first);
            for &n in nodes {
                let (own, next) = rest.split_at_mut(n as usize + 1 - at);
                updates.push(self.subtree(n as usize, at, own)?);
                (rest, at) = (next, n as usize + 1);
            }
            return Ok(updates);
        }
        let total: f64 = nodes.iter().map(work).sum();
        // Split where the work before each sibling's middle passes half of the total.
        let mut before = 0.0;
        let mut half = 0;
        for n in nodes {
            if before + 0.5 * work(n) < 0.5 * total {
                half += 1;
            }
            before += work(n);
        }
        let half = half.clamp(1, nodes.len() - 1);
        let (low, high) = nodes.split_at(half);
        let middle = low[half - 1] as usize + 1;
        let (left, right) = panels.split_at_mut(middle - first);
        let (a, b) = rayon::join(|| self.siblings(low, first, left), || self.siblings(high, middle, right));
        let mut updates = a?;
        updates.extend(b?);
        Ok(updates)
    }

    /// Factors one subtree and returns its root's update matrix.
    fn subtree(&self, s: usize, first: usize, panels: &mut [Vec<f64>]) -> Result<Update, NotPositiveDefinite> {
        let node = &self.symbolic.supernodes[s];
        let (below, own) = panels.split_at_mut(s - first);
        let children = self.siblings(&node.children, first, below)?;
        let panel = &mut own[0];
        let (p, r) = (node.pivot_strips(), node.update_strips());
        let mut update = vec![0.0; triangle_offset(r)];
        self.assemble_columns(node, panel);
        for (child, values) in node.children.iter().zip(children) {
            extend_add(&self.symbolic.supernodes[*child as usize], &values, p, panel, &mut update);
        }
        front::factor_panel(panel, p, r)
            .map_err(|row| NotPositiveDefinite { position: node.start + row / 3, coordinate: row % 3 })?;
        front::update_matrix(panel, p, r, &mut update);
        Ok(update)
    }

    /// Writes the supernode's columns of A + shift into its panel; padding pivots become identity.
    fn assemble_columns(&self, node: &Supernode, panel: &mut [f64]) {
        panel.fill(0.0);
        let p = node.pivot_strips();
        for pad in node.pivots..p * STRIP_POINTS {
            (0..3).for_each(|c| {
                panel[panel_offset(p, pad / STRIP_POINTS) + (3 * pad + c) * STRIP + 3 * (pad % 4) + c] = 1.0
            });
        }
        for column in 0..node.pivots {
            for k in self.matrix.pattern.column(node.start + column) {
                let place = self.symbolic.block_place[k] as usize;
                let base = panel_offset(p, place / STRIP_POINTS) + 3 * (place % STRIP_POINTS);
                let block = &self.matrix.blocks[k];
                for c in 0..3 {
                    let at = base + (3 * column + c) * STRIP;
                    (0..3).for_each(|i| panel[at + i] = block[3 * i + c]);
                }
            }
            if let Some(&shift) = self.shift.get(node.start + column) {
                let base = panel_offset(p, column / STRIP_POINTS) + 3 * (column % STRIP_POINTS);
                (0..3).for_each(|c| panel[base + (3 * column + c) * STRIP + c] += shift);
            }
        }
    }
}

/// Adds a child's update matrix into its parent's panel (pivot columns) and update matrix.
fn extend_add(child: &Supernode, values: &[f64], p: usize, panel: &mut [f64], update: &mut [f64]) {
    let pivots = p * STRIP_POINTS;
    for (i, &row) in child.place_in_parent.iter().enumerate() {
        let source = &values[triangle_offset(i / STRIP_POINTS) + 3 * (i % STRIP_POINTS)..];
        let row = row as usize;
        let strip = row / STRIP_POINTS;
        let lane = 3 * (row % STRIP_POINTS);
        let in_panel = panel_offset(p, strip) + lane;
        let in_update = if strip >= p { triangle_offset(strip - p) + lane } else { 0 };
        for (j, &column) in child.place_in_parent[..=i].iter().enumerate() {
            let column = column as usize;
            let target = if column < pivots {
                &mut panel[in_panel + 3 * column * STRIP..]
            } else {
                &mut update[in_update + 3 * (column - pivots) * STRIP..]
            };
            let source = &source[3 * j * STRIP..3 * j * STRIP + 2 * STRIP + 3];
            let target = &mut target[..2 * STRIP + 3];
            for c in 0..3 {
                for k in 0..3 {
                    target[c * STRIP + k] += source[c * STRIP + k];
                }
            }
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::{BlockPattern, nested_dissection};
    use super::*;
    use crate::gradcheck::SplitMix64;

    /// A diagonally dominant matrix on random points joined to their neighbours within `reach`, in elimination order.
    pub(crate) fn random_system(n: usize, reach: f64, seed: u64) -> (Symbolic, BlockMatrix) {
        let mut rng = SplitMix64(seed);
        let points: Vec<[f64; 3]> = (0..n).map(|_| std::array::from_fn(|_| rng.uniform())).collect();
        let near = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>() < reach * reach;
        let (mut start, mut neighbour) = (vec![0u32], vec![]);
        for i in 0..n {
            neighbour.extend((0..n as u32).filter(|&j| j as usize != i && near(&points[i], &points[j as usize])));
            start.push(neighbour.len() as u32);
        }
        let d = nested_dissection(&points, &start, &neighbour);
        let mut position = vec![0u32; n];
        d.order.iter().enumerate().for_each(|(p, &v)| position[v as usize] = p as u32);
        let mut pairs = vec![];
        for i in 0..n {
            for &j in &neighbour[start[i] as usize..start[i + 1] as usize] {
                let (a, b) = (position[i], position[j as usize]);
                pairs.push((a.max(b), a.min(b)));
            }
        }
        let pattern = BlockPattern::from_pairs(n, &mut pairs);
        let symbolic = Symbolic::new(&pattern, &d);
        let mut matrix = BlockMatrix::zeros(pattern);
        for j in 0..n {
            for k in matrix.pattern.column(j) {
                let block: [f64; 9] = std::array::from_fn(|_| 0.2 * rng.normal());
                matrix.blocks[k] = block;
                if matrix.pattern.row[k] as usize == j {
                    (0..3).for_each(|c| matrix.blocks[k][4 * c] = 8.0 + rng.uniform());
                }
            }
        }
        (symbolic, matrix)
    }

    fn solve_error(symbolic: &Symbolic, matrix: &BlockMatrix) -> f64 {
        let mut factor = Factor::default();
        factor.factor(symbolic, matrix, &[]).expect("diagonally dominant");
        let mut rng = SplitMix64(1);
        let n = 3 * symbolic.columns;
        let x: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let mut b = vec![0.0; n];
        matrix.times(&x, &mut b);
        factor.solve(symbolic, &mut b);
        x.iter().zip(&b).fold(0.0, |m, (x, b)| m.max((x - b).abs()))
    }

    #[test]
    fn a_factored_system_is_solved_to_rounding() {
        for (n, reach) in [(1, 1.0), (5, 2.0), (60, 0.3), (400, 0.15), (2500, 0.13), (300, 0.02)] {
            let (symbolic, matrix) = random_system(n, reach, 11);
            let error = solve_error(&symbolic, &matrix);
            println!(
                "{n} points: error {error:.1e}, {} supernodes, {} parts",
                symbolic.supernodes.len(),
                symbolic.parts.len()
            );
            assert!(error < 1e-12);
        }
    }

    #[test]
    fn factor_solution_and_product_have_the_same_bytes_for_any_number_of_threads() {
        let (symbolic, matrix) = random_system(2500, 0.13, 4);
        let n = 3 * symbolic.columns;
        let mut rng = SplitMix64(2);
        let b: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let (mut whole, mut error) = (vec![0.0; n], 0.0f64);
        matrix.times(&b, &mut whole);
        let mut bytes = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let (mut factor, mut x, mut product) = (Factor::default(), b.clone(), vec![0.0; n]);
            pool.install(|| {
                factor.factor(&symbolic, &matrix, &[]).expect("diagonally dominant");
                factor.solve(&symbolic, &mut x);
                matrix.times_in_parts(&symbolic, &b, &mut product);
            });
            error = product.iter().zip(&whole).fold(error, |m, (a, b)| m.max((a - b).abs()));
            factor.panels.iter().flatten().chain(&x).chain(&product).map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        assert!(symbolic.factor_flops() > 5e7, "large enough to run in parallel");
        assert!(bytes(1) == bytes(4));
        println!("{} parts, product in parts against whole {error:.1e}", symbolic.parts.len());
        assert!(symbolic.parts.len() > 2 && error < 1e-12);
    }

    #[test]
    fn an_indefinite_matrix_is_refused_and_a_shift_repairs_it() {
        let (symbolic, mut matrix) = random_system(200, 0.2, 6);
        let k = matrix.pattern.column(57).start;
        matrix.blocks[k][4] = -1.0;
        let mut factor = Factor::default();
        let refused = factor.factor(&symbolic, &matrix, &[]);
        println!("{refused:?}");
        assert_eq!(refused.map_err(|e| e.position), Err(57));
        factor.factor(&symbolic, &matrix, &[10.0; 200]).expect("shifted");
        matrix.blocks[k][4] = f64::NAN;
        assert!(factor.factor(&symbolic, &matrix, &[]).is_err());
    }
}

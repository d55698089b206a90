//! Solves with the factor: L y = b going up the tree, Lᵀ x = y coming down.

use super::cholesky::Factor;
use super::front::{Column, STRIP, columns, load, panel_offset, store};
use super::symbolic::{STRIP_POINTS, Supernode, Symbolic};
use crate::lanes::{Lanes, splat};

impl Factor {
    /// Solves A x = b in place; b has 3 entries per point, in elimination order.
    pub fn solve(&self, symbolic: &Symbolic, b: &mut [f64]) {
        let largest = symbolic.supernodes.iter().map(|s| s.pivot_strips()).max().unwrap_or(0);
        let mut own = vec![[0.0; STRIP]; largest];
        for (node, panel) in symbolic.supernodes.iter().zip(&self.panels) {
            forward(node, panel, &mut own, b);
        }
        for (node, panel) in symbolic.supernodes.iter().zip(&self.panels).rev() {
            backward(node, panel, &mut own, b);
        }
    }
}

/// Copies the supernode's entries of x into strips; padding is zero.
fn gather_own(node: &Supernode, own: &mut [Column], x: &[f64]) {
    let x = &x[3 * node.start..3 * (node.start + node.pivots)];
    for (strip, values) in own.iter_mut().zip(x.chunks(STRIP)) {
        *strip = [0.0; STRIP];
        strip[..values.len()].copy_from_slice(values);
    }
}

fn scatter_own(node: &Supernode, own: &[Column], x: &mut [f64]) {
    let x = &mut x[3 * node.start..3 * (node.start + node.pivots)];
    x.chunks_mut(STRIP).zip(own).for_each(|(values, strip)| values.copy_from_slice(&strip[..values.len()]));
}

/// Σ_k column_k y_k.
#[inline(always)]
fn strip_times(strip: &[Column], y: &[Column]) -> [Lanes; 3] {
    let mut sums = [[splat(0.0); 3]; 2];
    for (column, y) in strip.as_chunks::<STRIP>().0.iter().zip(y) {
        for k in 0..STRIP {
            let (rows, s) = (load(&column[k]), splat(y[k]));
            (0..3).for_each(|r| sums[k % 2][r] = rows[r].mul_add(s, sums[k % 2][r]));
        }
    }
    std::array::from_fn(|r| sums[0][r] + sums[1][r])
}

/// y_k −= column_k · v for every column.
#[inline(always)]
fn strip_transpose_times(strip: &[Column], v: [Lanes; 3], y: &mut [Column]) {
    for (tile, y) in strip.as_chunks::<STRIP>().0.iter().zip(y) {
        let mut old = load(y);
        for quarter in 0..3 {
            let product = |q: usize| {
                let rows = load(&tile[4 * quarter + q]);
                rows[0].mul_add(v[0], rows[1].mul_add(v[1], rows[2] * v[2]))
            };
            let [a, b, c, d] = Lanes::transpose([product(0), product(1), product(2), product(3)]);
            old[quarter] -= (a + b) + (c + d);
        }
        store(old, y);
    }
}

fn forward(node: &Supernode, panel: &[f64], own: &mut [Column], x: &mut [f64]) {
    let (p, r) = (node.pivot_strips(), node.update_strips());
    let own = &mut own[..p];
    gather_own(node, own, x);
    for j in 0..p {
        let strip = columns(&panel[panel_offset(p, j)..panel_offset(p, j + 1)]);
        let (left, diagonal) = strip.split_at(STRIP * j);
        let (done, rest) = own.split_at_mut(j);
        let before = strip_times(left, done);
        let mut t = rest[0];
        let old = load(&t);
        store(std::array::from_fn(|r| old[r] - before[r]), &mut t);
        for k in 0..STRIP {
            t[k] *= diagonal[k][k];
            for i in k + 1..STRIP {
                t[i] -= diagonal[k][i] * t[k];
            }
        }
        rest[0] = t;
    }
    for i in 0..r {
        let strip = columns(&panel[panel_offset(p, p + i)..panel_offset(p, p + i + 1)]);
        let mut product = [0.0; STRIP];
        store(strip_times(strip, own), &mut product);
        for (place, &row) in node.rows[i * STRIP_POINTS..].iter().take(STRIP_POINTS).enumerate() {
            (0..3).for_each(|c| x[3 * row as usize + c] -= product[3 * place + c]);
        }
    }
    scatter_own(node, own, x);
}

fn backward(node: &Supernode, panel: &[f64], own: &mut [Column], x: &mut [f64]) {
    let (p, r) = (node.pivot_strips(), node.update_strips());
    let own = &mut own[..p];
    gather_own(node, own, x);
    for i in 0..r {
        let strip = columns(&panel[panel_offset(p, p + i)..panel_offset(p, p + i + 1)]);
        let mut known = [0.0; STRIP];
        for (place, &row) in node.rows[i * STRIP_POINTS..].iter().take(STRIP_POINTS).enumerate() {
            (0..3).for_each(|c| known[3 * place + c] = x[3 * row as usize + c]);
        }
        strip_transpose_times(strip, load(&known), own);
    }
    for j in (0..p).rev() {
        let strip = columns(&panel[panel_offset(p, j)..panel_offset(p, j + 1)]);
        let (left, diagonal) = strip.split_at(STRIP * j);
        let (before, rest) = own.split_at_mut(j);
        let t = &mut rest[0];
        for k in (0..STRIP).rev() {
            let known: f64 = (k + 1..STRIP).map(|i| diagonal[k][i] * t[i]).sum();
            t[k] = (t[k] - known) * diagonal[k][k];
        }
        strip_transpose_times(left, load(t), before);
    }
    scatter_own(node, own, x);
}

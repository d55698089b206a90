//! Solves with the factor: L y = b going up the tree, Lᵀ x = y coming down.

use super::cholesky::Factor;
use super::front::{Column, STRIP, columns, load, panel_offset, store};
use super::symbolic::{STRIP_POINTS, Supernode, Symbolic};
use crate::lanes::{Lanes, splat};

impl Factor {
    /// Solves A x = b in place; b has 3 entries per point, in elimination order.
    pub fn solve(&self, symbolic: &Symbolic, b: &mut [f64]) {
        let (nodes, panels) = (&symbolic.supernodes, &self.panels);
        symbolic.scatter_parts(b, |part, x, after| {
            let mut own = strips(&nodes[part.nodes.clone()]);
            let mut place = Place { x, first: part.points.start, after };
            part.nodes.clone().for_each(|s| forward(&nodes[s], &panels[s], &mut own, &mut place));
        });
        let mut own = strips(nodes);
        let mut whole = Place { x: b, first: 0, after: &mut [] };
        symbolic.top().for_each(|s| forward(&nodes[s], &panels[s], &mut own, &mut whole));
        symbolic.top().rev().for_each(|s| {
            gather_own(&nodes[s], &mut own, whole.x, 0);
            let (x, own) = (&mut *whole.x, &mut own);
            backward(&nodes[s], &panels[s], own, |row| row_of(x, row));
            scatter_own(&nodes[s], own, x, 0);
        });
        let known = if symbolic.parts.is_empty() { vec![] } else { b.to_vec() };
        symbolic.for_parts(b, |part, x| {
            let mut own = strips(&nodes[part.nodes.clone()]);
            let (first, end) = (part.points.start, part.points.end);
            for s in part.nodes.clone().rev() {
                gather_own(&nodes[s], &mut own, x, first);
                let row = |row: usize| if row < end { row_of(x, row - first) } else { row_of(&known, row) };
                backward(&nodes[s], &panels[s], &mut own, row);
                scatter_own(&nodes[s], &own, x, first);
            }
        });
    }
}

/// Entries of x from position `first` on that belong together, and a place for what is subtracted from later ones.
struct Place<'a> {
    x: &'a mut [f64],
    first: usize,
    after: &'a mut [f64],
}

/// Strips for the pivots of the largest of the supernodes.
fn strips(nodes: &[Supernode]) -> Vec<Column> {
    vec![[0.0; STRIP]; nodes.iter().map(|s| s.pivot_strips()).max().unwrap_or(0)]
}

/// The three entries of one point.
#[inline(always)]
fn row_of(x: &[f64], row: usize) -> [f64; 3] {
    [x[3 * row], x[3 * row + 1], x[3 * row + 2]]
}

/// Copies the supernode's entries of x, which starts at position `first`, into strips; padding is zero.
fn gather_own(node: &Supernode, own: &mut [Column], x: &[f64], first: usize) {
    let start = node.start - first;
    let x = &x[3 * start..3 * (start + node.pivots)];
    for (strip, values) in own.iter_mut().zip(x.chunks(STRIP)) {
        *strip = [0.0; STRIP];
        strip[..values.len()].copy_from_slice(values);
    }
}

/// The inverse of [`gather_own`].
fn scatter_own(node: &Supernode, own: &[Column], x: &mut [f64], first: usize) {
    let start = node.start - first;
    let x = &mut x[3 * start..3 * (start + node.pivots)];
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

/// L y = b for the supernode's pivots; its share in later rows is subtracted there.
fn forward(node: &Supernode, panel: &[f64], own: &mut [Column], place: &mut Place) {
    let (p, r) = (node.pivot_strips(), node.update_strips());
    let own = &mut own[..p];
    gather_own(node, own, place.x, place.first);
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
        for (n, &row) in node.rows[i * STRIP_POINTS..].iter().take(STRIP_POINTS).enumerate() {
            let at = 3 * (row as usize - place.first);
            let target = match at.checked_sub(place.x.len()) {
                None => &mut place.x[at..at + 3],
                Some(after) => &mut place.after[after..after + 3],
            };
            (0..3).for_each(|c| target[c] -= product[3 * n + c]);
        }
    }
    scatter_own(node, own, place.x, place.first);
}

/// Lᵀ x = y for the supernode's pivots, given the `later` entries by position.
#[inline(always)]
fn backward(node: &Supernode, panel: &[f64], own: &mut [Column], later: impl Fn(usize) -> [f64; 3]) {
    let (p, r) = (node.pivot_strips(), node.update_strips());
    let own = &mut own[..p];
    for i in 0..r {
        let strip = columns(&panel[panel_offset(p, p + i)..panel_offset(p, p + i + 1)]);
        let mut known = [0.0; STRIP];
        for (place, &row) in node.rows[i * STRIP_POINTS..].iter().take(STRIP_POINTS).enumerate() {
            known[3 * place..3 * place + 3].copy_from_slice(&later(row as usize));
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
}

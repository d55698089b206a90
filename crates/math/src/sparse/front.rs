//! Dense kernels of one front, in *strips*: 12 rows stored column after column, 12 numbers each.
//!
//! A strip of the factor is at once the left operand (12 contiguous rows per column) and the right operand (4 of them
//! broadcast) of the update C −= A Bᵀ, so nothing is ever packed or copied. Triangular shapes store strip i with the
//! columns 0..12(i+1) it needs.

use crate::lanes::{Lanes, splat};
use rayon::prelude::*;

/// Scalar rows of a strip: three vector registers of four, four points of three coordinates.
pub const STRIP: usize = 12;
/// Numbers in a square tile.
pub const TILE: usize = STRIP * STRIP;
/// Columns per pass of an update, so that two strips' worth (2 × 12 kB) stay in the first-level cache.
const PASS: usize = 128;
/// Multiplications under which a loop over strips is not worth sharing between threads.
const PARALLEL_WORK: usize = 400_000;

/// First number of strip `i` in triangular storage.
pub fn triangle_offset(i: usize) -> usize {
    TILE * i * (i + 1) / 2
}

/// Length of the panel (columns of the factor) of a front with `p` pivot strips and `r` strips below.
pub fn panel_len(p: usize, r: usize) -> usize {
    triangle_offset(p) + r * p * TILE
}

/// First number of row strip `i` of a panel with `p` pivot strips.
pub fn panel_offset(p: usize, i: usize) -> usize {
    if i <= p { triangle_offset(i) } else { triangle_offset(p) + (i - p) * p * TILE }
}

/// One column of a strip.
pub type Column = [f64; STRIP];

/// Views a slice as strip columns.
pub fn columns(strip: &[f64]) -> &[Column] {
    strip.as_chunks().0
}

/// Views a slice as strip columns, to write.
pub fn columns_mut(strip: &mut [f64]) -> &mut [Column] {
    strip.as_chunks_mut().0
}

/// A strip column in registers.
#[inline(always)]
pub fn load(column: &Column) -> [Lanes; 3] {
    let [a, b, c, d, e, f, g, h, i, j, k, l] = *column;
    [Lanes::new([a, b, c, d]), Lanes::new([e, f, g, h]), Lanes::new([i, j, k, l])]
}

/// Registers back to a strip column.
#[inline(always)]
pub fn store(v: [Lanes; 3], column: &mut Column) {
    (0..3).for_each(|r| column[4 * r..4 * r + 4].copy_from_slice(v[r].as_array()));
}

/// Four columns of C −= A Bᵀ, with rows `OFF..OFF+4` of B.
#[inline(always)]
fn update_quarter<const OFF: usize>(c: &mut [Column], a: &[Column], b: &[Column]) {
    let mut sum = [[splat(0.0); 3]; 4];
    for (a, b) in a.iter().zip(b) {
        let rows = load(a);
        for q in 0..4 {
            let s = splat(b[OFF + q]);
            for r in 0..3 {
                sum[q][r] = rows[r].mul_add(s, sum[q][r]);
            }
        }
    }
    for q in 0..4 {
        let old = load(&c[q]);
        store([old[0] - sum[q][0], old[1] - sum[q][1], old[2] - sum[q][2]], &mut c[q]);
    }
}

/// A 12×12 tile of C −= A Bᵀ.
#[inline]
fn update_tile(c: &mut [Column], a: &[Column], b: &[Column]) {
    update_quarter::<0>(&mut c[0..4], a, b);
    update_quarter::<4>(&mut c[4..8], a, b);
    update_quarter::<8>(&mut c[8..12], a, b);
}

/// Cholesky factor of a diagonal tile (lower half), in place; the diagonal is left *inverted*, which is what every later
/// use multiplies by. Err(row) where the pivot is not positive.
fn factor_tile(tile: &mut [Column]) -> Result<(), usize> {
    for j in 0..STRIP {
        let pivot = tile[j][j];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return Err(j);
        }
        let inverse = 1.0 / pivot.sqrt();
        let (head, tail) = tile.split_at_mut(j + 1);
        let column = &mut head[j];
        column[j + 1..].iter_mut().for_each(|v| *v *= inverse);
        column[j] = inverse;
        let rows = load(column);
        for (k, later) in tail.iter_mut().enumerate() {
            let s = splat(-column[j + 1 + k]);
            let old = load(later);
            store(std::array::from_fn(|r| rows[r].mul_add(s, old[r])), later);
        }
    }
    Ok(())
}

/// X ← X L⁻ᵀ for a tile X under the factored diagonal tile L.
#[inline]
fn solve_tile(x: &mut [Column], l: &[Column]) {
    let mut v: [[Lanes; 3]; STRIP] = std::array::from_fn(|j| load(&x[j]));
    for j in 0..STRIP {
        let d = splat(l[j][j]);
        v[j] = [v[j][0] * d, v[j][1] * d, v[j][2] * d];
        for k in j + 1..STRIP {
            let s = splat(-l[j][k]);
            (0..3).for_each(|r| v[k][r] = v[j][r].mul_add(s, v[k][r]));
        }
    }
    (0..STRIP).for_each(|j| store(v[j], &mut x[j]));
}

/// Applies `f` to every strip, on several threads where the work is worth it; strips never depend on each other here.
fn for_each_strip(strips: Vec<(usize, &mut [f64])>, work: usize, f: impl Fn(usize, &mut [f64]) + Sync) {
    if work > PARALLEL_WORK && rayon::current_num_threads() > 1 {
        strips.into_par_iter().with_max_len(4).for_each(|(i, s)| f(i, s));
    } else {
        strips.into_iter().for_each(|(i, s)| f(i, s));
    }
}

/// Factors a panel in place (left-looking by tiles). Err(scalar pivot within the front).
pub fn factor_panel(panel: &mut [f64], p: usize, r: usize) -> Result<(), usize> {
    for j in 0..p {
        let (head, tail) = panel.split_at_mut(panel_offset(p, j + 1));
        let own = columns_mut(&mut head[panel_offset(p, j)..]);
        let (before, diagonal) = own.split_at_mut(STRIP * j);
        for pass in before.chunks(PASS) {
            update_tile(diagonal, pass, pass);
        }
        factor_tile(diagonal).map_err(|row| STRIP * j + row)?;
        let (before, diagonal) = (&*before, &*diagonal);
        let mut rest = tail;
        let mut strips = Vec::with_capacity(p + r - j);
        for i in j + 1..p + r {
            let (strip, next) = rest.split_at_mut(panel_offset(p, i + 1) - panel_offset(p, i));
            strips.push((i, strip));
            rest = next;
        }
        let work = strips.len() * STRIP * STRIP * STRIP * (j + 1);
        for_each_strip(strips, work, |_, strip| {
            let (left, tile) = columns_mut(strip).split_at_mut(STRIP * j);
            for (a, b) in left.chunks(PASS).zip(before.chunks(PASS)) {
                update_tile(&mut tile[..STRIP], a, b);
            }
            solve_tile(&mut tile[..STRIP], diagonal);
        });
    }
    Ok(())
}

/// U −= L₂ L₂ᵀ: the update matrix (triangular strips) from the panel's strips below the pivots.
pub fn update_matrix(panel: &[f64], p: usize, r: usize, update: &mut [f64]) {
    let strip = |i: usize| columns(&panel[panel_offset(p, p + i)..panel_offset(p, p + i + 1)]);
    let mut rest = update;
    let mut strips = Vec::with_capacity(r);
    for i in (0..r).map(|i| (i + 1) * TILE) {
        let (own, next) = rest.split_at_mut(i);
        strips.push((strips.len(), own));
        rest = next;
    }
    for_each_strip(strips, r * r * p * TILE * STRIP / 2, |i, own| {
        let c = columns_mut(own);
        for (k, a) in strip(i).chunks(PASS).enumerate() {
            for j in 0..=i {
                let b = &strip(j)[k * PASS..k * PASS + a.len()];
                update_tile(&mut c[STRIP * j..STRIP * (j + 1)], a, b);
            }
        }
    });
}

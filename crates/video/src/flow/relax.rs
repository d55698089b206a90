//! Red–black successive over-relaxation of the system of [`super::variational`].
//!
//! The pixels of one colour of a checkerboard depend on those of the other alone. Each colour is kept by itself, row by row, so
//! that a half sweep reads and writes whole vectors: pixel x = 2k + p of row y is number k of its colour's row, p = 0 or 1.

use super::variational::System;

/// The pixels of one colour, with a border of zeros: one value at either end of a row, one row above and below.
struct Colour {
    a11: Vec<f32>,
    a12: Vec<f32>,
    a22: Vec<f32>,
    b1: Vec<f32>,
    b2: Vec<f32>,
    smooth: Vec<f32>,
    du: Vec<f32>,
    dv: Vec<f32>,
}

/// Where pixels of a picture are in its colours.
#[derive(Clone, Copy)]
struct Board {
    width: usize,
    height: usize,
    stride: usize,
}

impl Board {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, stride: width.div_ceil(2) + 2 }
    }

    /// First column of a colour in a row.
    fn first(self, y: usize, colour: usize) -> usize {
        (y + colour) % 2
    }

    /// How many pixels of a colour a row has.
    fn count(self, y: usize, colour: usize) -> usize {
        (self.width + 1 - self.first(y, colour)) / 2
    }

    /// Where a row's first pixel is.
    fn row(self, y: usize) -> usize {
        (y + 1) * self.stride + 1
    }

    /// The values of one colour.
    fn taken(self, values: &[f32], colour: usize) -> Vec<f32> {
        let mut out = vec![0.0; (self.height + 2) * self.stride];
        for y in 0..self.height {
            let from = values[y * self.width..][..self.width].iter().skip(self.first(y, colour)).step_by(2);
            out[self.row(y)..].iter_mut().zip(from).for_each(|(o, v)| *o = *v);
        }
        out
    }

    /// The opposite.
    fn put_back(self, from: &[f32], colour: usize, values: &mut [f32]) {
        for y in 0..self.height {
            let to = values[y * self.width..][..self.width].iter_mut().skip(self.first(y, colour)).step_by(2);
            to.zip(&from[self.row(y)..]).for_each(|(o, v)| *o = *v);
        }
    }
}

/// Solves for the increments `du`, `dv` \[y · width + x\] in place, by some sweeps over both colours.
pub(super) fn relax(width: usize, s: &System, sweeps: usize, omega: f32, du: &mut [f32], dv: &mut [f32]) {
    let board = Board::new(width, du.len() / width.max(1));
    let [mut even, mut odd] = [0, 1].map(|colour| Colour {
        a11: board.taken(&s.a11, colour),
        a12: board.taken(&s.a12, colour),
        a22: board.taken(&s.a22, colour),
        b1: board.taken(&s.b1, colour),
        b2: board.taken(&s.b2, colour),
        smooth: board.taken(&s.smooth, colour),
        du: board.taken(du, colour),
        dv: board.taken(dv, colour),
    });
    for _ in 0..sweeps {
        half_sweep(board, 0, omega, &mut even, &odd);
        half_sweep(board, 1, omega, &mut odd, &even);
    }
    for (colour, c) in [even, odd].iter().enumerate() {
        board.put_back(&c.du, colour, du);
        board.put_back(&c.dv, colour, dv);
    }
}

fn half_sweep(board: Board, colour: usize, omega: f32, c: &mut Colour, other: &Colour) {
    for y in 0..board.height {
        let (n, at) = (board.count(y, colour), board.row(y));
        // The neighbours to the left and right are numbers k − 1 and k of the other colour, or k and k + 1.
        let left = at - 1 + board.first(y, colour);
        let (above, below) = (at - board.stride, at + board.stride);
        let neighbour = |from: usize| Neighbour {
            smooth: &other.smooth[from..from + n],
            du: &other.du[from..from + n],
            dv: &other.dv[from..from + n],
        };
        let own = Row {
            a11: &c.a11[at..at + n],
            a12: &c.a12[at..at + n],
            a22: &c.a22[at..at + n],
            b1: &c.b1[at..at + n],
            b2: &c.b2[at..at + n],
            smooth: &c.smooth[at..at + n],
        };
        let around = [left, left + 1, above, below].map(neighbour);
        own.relax(&around, omega, &mut c.du[at..at + n], &mut c.dv[at..at + n]);
    }
}

/// A row's part of the system.
struct Row<'a> {
    a11: &'a [f32],
    a12: &'a [f32],
    a22: &'a [f32],
    b1: &'a [f32],
    b2: &'a [f32],
    smooth: &'a [f32],
}

/// What lies to one side of a row's pixels.
struct Neighbour<'a> {
    smooth: &'a [f32],
    du: &'a [f32],
    dv: &'a [f32],
}

impl Row<'_> {
    /// Relaxes a row of one colour between its neighbours to the left, right, above and below. Beyond the picture they are zero.
    #[inline(never)]
    fn relax(&self, [left, right, above, below]: &[Neighbour; 4], omega: f32, du: &mut [f32], dv: &mut [f32]) {
        let n = du.len();
        // Slices of one length let the compiler drop bounds checks and use vector units.
        let (a11, a12, a22) = (&self.a11[..n], &self.a12[..n], &self.a22[..n]);
        let (b1, b2, own) = (&self.b1[..n], &self.b2[..n], &self.smooth[..n]);
        let (ls, lu, lv) = (&left.smooth[..n], &left.du[..n], &left.dv[..n]);
        let (ru, rv) = (&right.du[..n], &right.dv[..n]);
        let (us, uu, uv) = (&above.smooth[..n], &above.du[..n], &above.dv[..n]);
        let (bu, bv) = (&below.du[..n], &below.dv[..n]);
        let dv = &mut dv[..n];
        for i in 0..n {
            let gu = b1[i] + ls[i] * lu[i] + own[i] * ru[i] + us[i] * uu[i] + own[i] * bu[i];
            let gv = b2[i] + ls[i] * lv[i] + own[i] * rv[i] + us[i] * uv[i] + own[i] * bv[i];
            let (u, v) = (du[i], dv[i]);
            let u = u + omega * ((gu - a12[i] * v) / a11[i] - u);
            du[i] = u;
            dv[i] = v + omega * ((gv - a12[i] * u) / a22[i] - v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same, pixel by pixel as the equations say.
    fn plainly(w: usize, s: &System, sweeps: usize, omega: f32, du: &mut [f32], dv: &mut [f32]) {
        let h = du.len() / w;
        for half in 0..2 * sweeps {
            for i in (0..w * h).filter(|i| (i % w + i / w) % 2 == half % 2) {
                let (x, y) = (i % w, i / w);
                let (mut gu, mut gv) = (s.b1[i], s.b2[i]);
                let mut edge = |k: f32, j: usize| (gu, gv) = (gu + k * du[j], gv + k * dv[j]);
                if x > 0 {
                    edge(s.smooth[i - 1], i - 1);
                }
                if x + 1 < w {
                    edge(s.smooth[i], i + 1);
                }
                if y > 0 {
                    edge(s.smooth[i - w], i - w);
                }
                if y + 1 < h {
                    edge(s.smooth[i], i + w);
                }
                du[i] += omega * ((gu - s.a12[i] * dv[i]) / s.a11[i] - du[i]);
                dv[i] += omega * ((gv - s.a12[i] * du[i]) / s.a22[i] - dv[i]);
            }
        }
    }

    #[test]
    fn colours_kept_apart_relax_to_the_same_bits_for_even_and_odd_sizes() {
        for (w, h) in [(16, 9), (17, 8), (31, 31), (2, 2), (1, 5)] {
            let mut state = w as u32;
            let mut some = |least: f32| -> Vec<f32> {
                let mut next = || {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    least + (state >> 8) as f32 / 8_388_608.0
                };
                (0..w * h).map(|_| next()).collect()
            };
            let s = System {
                a11: some(5.0),
                a12: some(0.0),
                a22: some(5.0),
                b1: some(-1.0),
                b2: some(-1.0),
                smooth: some(0.0),
            };
            let (mut du, mut dv) = (some(-1.0), some(-1.0));
            let (mut plain_u, mut plain_v) = (du.clone(), dv.clone());
            relax(w, &s, 3, 1.6, &mut du, &mut dv);
            plainly(w, &s, 3, 1.6, &mut plain_u, &mut plain_v);
            assert_eq!((du, dv), (plain_u, plain_v), "{w} × {h}");
        }
    }
}

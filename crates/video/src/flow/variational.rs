//! Variational refinement of a flow (Brox, Bruhn, Papenberg, Weickert: High Accuracy Optical Flow Estimation Based on a
//! Theory for Warping, ECCV 2004), with normalised data terms as in OpenCV's VariationalRefinement.
//!
//! E(w) = ∫ δ Ψ(|I_z + ∇I·dw|² / (|∇I|² + ζ²)) + γ Ψ(gradient constancy, likewise) + α Ψ(|∇u|² + |∇v|²),
//! Ψ(s²) = √(s² + ε²), linearised about the given flow; lagged weights, red–black successive over-relaxation.
//!
//! Untextured surfaces get their motion from their outlines alone, across many pixels: hence strong over-relaxation and more
//! sweeps on coarse levels, where they cost little.

use super::Gray;
use super::dis::Planes;
use super::relax::relax;
use std::ops::Range;

/// Weights and effort of the refinement.
pub(super) struct Refinement {
    /// Smoothness α.
    pub alpha: f32,
    /// Brightness constancy δ.
    pub delta: f32,
    /// Gradient constancy γ.
    pub gamma: f32,
    /// Updates of the lagged weights.
    pub rounds: usize,
    /// Relaxation sweeps per update.
    pub sweeps: usize,
    /// Over-relaxation ω.
    pub omega: f32,
}

impl Default for Refinement {
    fn default() -> Self {
        Self { alpha: 30.0, delta: 5.0, gamma: 10.0, rounds: 4, sweeps: 5, omega: 1.95 }
    }
}

/// ε of Ψ [px or levels].
const EPSILON_SQUARED: f32 = 1e-6;
/// ζ of the normalisation [levels/px].
const ZETA_SQUARED: f32 = 0.01;

/// Derivatives of the warped pair, `[y * width + x]`.
struct Derivatives {
    z: Vec<f32>,
    x: Vec<f32>,
    y: Vec<f32>,
    xx: Vec<f32>,
    xy: Vec<f32>,
    yy: Vec<f32>,
    xz: Vec<f32>,
    yz: Vec<f32>,
}

impl Derivatives {
    fn new(a: &Gray, b: &Gray, flow: &Planes) -> Self {
        let (w, h) = (a.width, a.height);
        let mut mean = a.clone();
        let mut z = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                let i = y * w + x;
                let warped = b.sample(x as f32 + flow.u[i], y as f32 + flow.v[i]);
                z.push(warped - a.values[i]);
                mean.values[i] = 0.5 * (warped + a.values[i]);
            }
        }
        let (x, y) = mean.gradients();
        let gray = |values: Vec<f32>| Gray { width: w, height: h, values };
        let (z, gx, gy) = (gray(z), gray(x), gray(y));
        let (xz, yz) = z.gradients();
        let (xx, xy) = gx.gradients();
        let (_, yy) = gy.gradients();
        Self { z: z.values, x: gx.values, y: gy.values, xx, xy, yy, xz, yz }
    }
}

/// The linear system per pixel: [a11 a12; a12 a22] dw = b + smoothness.
pub(super) struct System {
    pub a11: Vec<f32>,
    pub a12: Vec<f32>,
    pub a22: Vec<f32>,
    pub b1: Vec<f32>,
    pub b2: Vec<f32>,
    /// Smoothness weight of the pixel's edges to the right and below.
    pub smooth: Vec<f32>,
}

/// Refines `flow` from `a` to `b` in place.
pub(super) fn refine(a: &Gray, b: &Gray, flow: &mut Planes, settings: &Refinement) {
    let n = a.width * a.height;
    let d = Derivatives::new(a, b, flow);
    let mut du = vec![0.0f32; n];
    let mut dv = vec![0.0f32; n];
    let zeros = || vec![0.0f32; n];
    let mut s = System { a11: zeros(), a12: zeros(), a22: zeros(), b1: zeros(), b2: zeros(), smooth: zeros() };
    for _ in 0..settings.rounds {
        data_terms(&d, &du, &dv, settings, &mut s);
        smoothness(flow, &du, &dv, settings, &mut s);
        relax(a.width, &s, settings.sweeps, settings.omega, &mut du, &mut dv);
    }
    for i in 0..n {
        flow.u[i] += du[i];
        flow.v[i] += dv[i];
    }
}

fn data_terms(d: &Derivatives, du: &[f32], dv: &[f32], settings: &Refinement, s: &mut System) {
    let n = du.len();
    // Slices of one length let the compiler drop bounds checks and use vector units.
    let (z, x, y) = (&d.z[..n], &d.x[..n], &d.y[..n]);
    let (xx, xy, yy, xz, yz) = (&d.xx[..n], &d.xy[..n], &d.yy[..n], &d.xz[..n], &d.yz[..n]);
    let dv = &dv[..n];
    let (a11, a12, a22) = (&mut s.a11[..n], &mut s.a12[..n], &mut s.a22[..n]);
    let (b1, b2) = (&mut s.b1[..n], &mut s.b2[..n]);
    let (delta, gamma) = (0.5 * settings.delta, 0.5 * settings.gamma);
    for i in 0..n {
        let norm = 1.0 / (x[i] * x[i] + y[i] * y[i] + ZETA_SQUARED);
        let r = z[i] + x[i] * du[i] + y[i] * dv[i];
        let w = delta * norm / (r * r * norm + EPSILON_SQUARED).sqrt();
        let norm_x = 1.0 / (xx[i] * xx[i] + xy[i] * xy[i] + ZETA_SQUARED);
        let norm_y = 1.0 / (xy[i] * xy[i] + yy[i] * yy[i] + ZETA_SQUARED);
        let rx = xz[i] + xx[i] * du[i] + xy[i] * dv[i];
        let ry = yz[i] + xy[i] * du[i] + yy[i] * dv[i];
        let g = gamma / (rx * rx * norm_x + ry * ry * norm_y + EPSILON_SQUARED).sqrt();
        let (gx, gy) = (g * norm_x, g * norm_y);
        a11[i] = w * x[i] * x[i] + gx * xx[i] * xx[i] + gy * xy[i] * xy[i] + ZETA_SQUARED;
        a12[i] = w * x[i] * y[i] + gx * xx[i] * xy[i] + gy * xy[i] * yy[i];
        a22[i] = w * y[i] * y[i] + gx * xy[i] * xy[i] + gy * yy[i] * yy[i] + ZETA_SQUARED;
        b1[i] = -(w * z[i] * x[i] + gx * xz[i] * xx[i] + gy * yz[i] * xy[i]);
        b2[i] = -(w * z[i] * y[i] + gx * xz[i] * xy[i] + gy * yz[i] * yy[i]);
    }
}

/// Weights of the smoothness term and its share of matrix and right-hand side.
fn smoothness(flow: &Planes, du: &[f32], dv: &[f32], settings: &Refinement, s: &mut System) {
    let (w, h) = (flow.width, flow.height);
    let u: Vec<f32> = flow.u.iter().zip(du).map(|(a, b)| a + b).collect();
    let v: Vec<f32> = flow.v.iter().zip(dv).map(|(a, b)| a + b).collect();
    // Each pixel is met by its edges in one order: from above, from the left, to the right, to below.
    for y in 0..h {
        let row = y * w..(y + 1) * w;
        let below = if y + 1 < h { row.start + w..row.end + w } else { row.clone() };
        let (here, under) = ([&u[row.clone()], &v[row.clone()]], [&u[below.clone()], &v[below]]);
        weights(here, under, 0.5 * settings.alpha, &mut s.smooth[row]);
    }
    for y in 0..h {
        let (i, end) = (y * w, (y + 1) * w);
        if y > 0 {
            edges(flow, s, (i - w..end - w, i..end), i..end);
        }
        edges(flow, s, (i..end - 1, i + 1..end), i + 1..end);
        edges(flow, s, (i..end - 1, i + 1..end), i..end - 1);
        if y + 1 < h {
            edges(flow, s, (i..end, i + w..end + w), i..end);
        }
    }
}

/// Smoothness weight of each pixel of a row, by the flow (u, v) in it and in the row below.
fn weights(here: [&[f32]; 2], below: [&[f32]; 2], half_alpha: f32, out: &mut [f32]) {
    let n = out.len();
    let ([u, v], [bu, bv]) = (here.map(|r| &r[..n]), below.map(|r| &r[..n]));
    let weight = |ux: f32, uy: f32, vx: f32, vy: f32| {
        half_alpha / (ux * ux + uy * uy + vx * vx + vy * vy + EPSILON_SQUARED).sqrt()
    };
    for x in 0..n - 1 {
        out[x] = weight(u[x + 1] - u[x], bu[x] - u[x], v[x + 1] - v[x], bv[x] - v[x]);
    }
    out[n - 1] = weight(0.0, bu[n - 1] - u[n - 1], 0.0, bv[n - 1] - v[n - 1]);
}

/// The share of edges from each pixel of a range to its fellow of another one, in matrix and right-hand side of the pixels of `at`:
/// those the edges come from, or those they lead to.
fn edges(flow: &Planes, s: &mut System, (from, to): (Range<usize>, Range<usize>), at: Range<usize>) {
    let n = at.len();
    // What an edge adds to the pixel that it comes from it takes from the other.
    let sign = if at == from { 1.0 } else { -1.0 };
    let (k, u0, v0) = (&s.smooth[from.clone()][..n], &flow.u[from.clone()][..n], &flow.v[from][..n]);
    let (u1, v1) = (&flow.u[to.clone()][..n], &flow.v[to][..n]);
    let (a11, a22) = (&mut s.a11[at.clone()][..n], &mut s.a22[at.clone()][..n]);
    let (b1, b2) = (&mut s.b1[at.clone()][..n], &mut s.b2[at][..n]);
    for i in 0..n {
        b1[i] += sign * (k[i] * (u1[i] - u0[i]));
        b2[i] += sign * (k[i] * (v1[i] - v0[i]));
        a11[i] += k[i];
        a22[i] += k[i];
    }
}

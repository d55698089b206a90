//! Temporal smoothness Σ_t l₁ ‖ΔY‖² + l₂ ‖Δ²Y‖², Y the pseudo-anchors' positions (`animimic_rig::smoothness`), and its
//! Gauss–Newton model.
//!
//! A turn of joint j about ω moves pseudo-anchor r by ω × m_jr, m_jr its lever about the joint; a displacement along v moves it
//! by v·w_jr, w_jr its weight below the joint. The blocks JᵀGJ' between two frames (G = Σ b bᵀ over the basis) therefore need
//! only the moments K = Σ_r m_r m'_rᵀ, one product of lever matrices a third as high as the Jacobians:
//! * turn × turn: R_jᵀ (G ⊗ K) R_i with Σ_a \[b_a\]ₓ K \[b_a\]ₓᵀ = G ⊗ K, the polarised cofactor (tr K · I − Kᵀ for G = I);
//! * turn × slide: R_jᵀ \[Σ m w'\]ₓ G P_i; slide × slide: P_jᵀ G P_i Σ w w', P the parent's rotation.

use crate::solver::Model;
use animimic_math::so3::skew;
use animimic_rig::{Anchor, Kinematics, Posed};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::ops::Range;

/// Temporal smoothness of all vertices.
#[derive(Clone, Debug)]
pub struct Smoothness {
    /// Pseudo-anchors of all vertices.
    pub anchors: Vec<Anchor>,
    /// Weight l₁ of first differences [1/model unit²].
    pub velocity: f64,
    /// Weight l₂ of second differences [1/model unit²].
    pub acceleration: f64,
    /// Orthogonal directions in which motion is measured; a longer one damps motion along it more.
    pub basis: [DVec3; 3],
}

/// What one parameter triple does to the pseudo-anchors.
#[derive(Clone, Copy)]
enum Freedom {
    /// Rows of three lever components, about the joint.
    Turn,
    /// One row of weights.
    Slide,
}

/// A parameter triple: its kind, joint, first parameter and first row in the lever matrix.
#[derive(Clone, Copy)]
struct Triple {
    freedom: Freedom,
    joint: usize,
    parameter: usize,
    row: usize,
}

/// One frame's levers and the axes of its parameters.
struct Levers {
    /// Lever matrix, transposed: (pseudo-anchor, row).
    rows: Mat<f64>,
    /// Columns: world directions of the three parameters \[triple\].
    axes: Vec<DMat3>,
}

impl Smoothness {
    /// Directions of equal weight along all axes but one, which counts `stretch` times as much.
    pub fn stretched_basis(axis: DVec3, stretch: f64) -> [DVec3; 3] {
        let axis = axis.normalize();
        let (a, b) = axis.any_orthonormal_pair();
        [a, b, axis * stretch]
    }

    /// G = Σ b bᵀ.
    fn metric(&self) -> DMat3 {
        self.basis.iter().map(|b| DMat3::from_cols(*b * b.x, *b * b.y, *b * b.z)).fold(DMat3::ZERO, |a, b| a + b)
    }

    /// Differences that touch an active frame: (first frame, coefficients over consecutive frames, weight).
    fn stencils(&self, frames: usize, active: &Range<usize>) -> Vec<(usize, &'static [f64], f64)> {
        let first = (0..frames.saturating_sub(1)).map(|t| (t, [-1.0, 1.0].as_slice(), self.velocity));
        let second = (0..frames.saturating_sub(2)).map(|t| (t, [1.0, -2.0, 1.0].as_slice(), self.acceleration));
        let touches = |t: usize, len: usize| t < active.end && t + len > active.start;
        first.chain(second).filter(|(t, c, w)| *w > 0.0 && touches(*t, c.len())).collect()
    }

    /// Differences of the pseudo-anchors along every stencil, from the first frame that a stencil can reach.
    fn differences(&self, posed: &[Posed], active: &Range<usize>) -> Vec<(usize, &'static [f64], f64, Vec<DVec3>)> {
        let low = active.start.saturating_sub(2);
        // Frames after the active range take no part: when tracking forward they do not exist yet.
        let position = |t: usize| -> Vec<DVec3> { self.anchors.iter().map(|a| a.position(&posed[t])).collect() };
        let y: Vec<Vec<DVec3>> = (low..active.end).into_par_iter().map(position).collect();
        self.stencils(active.end, active)
            .into_iter()
            .map(|(t, c, w)| {
                let at = |k: usize| c.iter().enumerate().map(|(i, a)| y[t + i - low][k] * *a).sum();
                (t, c, w, (0..self.anchors.len()).map(at).collect())
            })
            .collect()
    }

    /// The energy of all differences that touch an active frame.
    pub fn energy(&self, posed: &[Posed], active: &Range<usize>) -> f64 {
        let metric = self.metric();
        let square = |d: &[DVec3]| d.iter().map(|v| v.dot(metric * *v)).sum::<f64>();
        self.differences(posed, active).iter().map(|(_, _, w, d)| w * square(d)).sum()
    }

    /// Adds the Gauss–Newton model of the energy.
    pub(crate) fn linearize(&self, kinematics: &Kinematics, posed: &[Posed], active: &Range<usize>, model: &mut Model) {
        let metric = self.metric();
        let triples = triples(kinematics);
        let table = self.table(kinematics.len());
        let levers: Vec<Levers> = active
            .clone()
            .into_par_iter()
            .map(|t| Levers::new(kinematics, &posed[t], &triples, &table, self.anchors.len()))
            .collect();
        // Q = Σ w c cᵀ over the stencils; (Q Y) drives the gradient, Q's bands the Hessian.
        let n = levers.len();
        let mut band = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        let mut pull = vec![vec![DVec3::ZERO; self.anchors.len()]; n];
        for (t, c, w, difference) in self.differences(posed, active) {
            for (i, a) in c.iter().enumerate() {
                let Some(s) = (t + i).checked_sub(active.start).filter(|&s| s < n) else { continue };
                pull[s].iter_mut().zip(&difference).for_each(|(p, v)| *p += metric * *v * (w * a));
                for (j, b) in c.iter().enumerate().filter(|(j, _)| *j <= i && t + j >= active.start) {
                    band[i - j][t + j - active.start] += w * a * b;
                }
            }
        }
        let [own, next, after] = model.bands();
        for (gap, blocks) in [own, next, after].into_iter().enumerate() {
            blocks.par_iter_mut().enumerate().for_each(|(s, block)| {
                add_product(&triples, &metric, &levers[s + gap], &levers[s], gap == 0, band[gap][s], block);
            });
        }
        let d = kinematics.dimension;
        for (s, (lever, pull)) in levers.iter().zip(&pull).enumerate() {
            lever.add_gradient(&triples, pull, &mut model.gradient[s * d..(s + 1) * d]);
        }
    }

    /// The pseudo-anchors as a dense table: [joint][x, y, z, weight][pseudo-anchor].
    fn table(&self, joints: usize) -> Vec<f64> {
        let r = self.anchors.len();
        let mut table = vec![0.0; joints * 4 * r];
        for (k, anchor) in self.anchors.iter().enumerate() {
            for s in &anchor.shares {
                let column = [s.weighted_rest.x, s.weighted_rest.y, s.weighted_rest.z, s.weight];
                column.iter().enumerate().for_each(|(c, v)| table[(4 * s.joint + c) * r + k] = *v);
            }
        }
        table
    }
}

fn triples(kinematics: &Kinematics) -> Vec<Triple> {
    let (mut all, mut row) = (Vec::new(), 0);
    for joint in 0..kinematics.len() {
        let offsets =
            [(Freedom::Turn, 3, kinematics.turn_offset[joint]), (Freedom::Slide, 1, kinematics.slide_offset[joint])];
        for (freedom, rows, offset) in offsets {
            if let Some(parameter) = offset {
                all.push(Triple { freedom, joint, parameter, row });
                row += rows;
            }
        }
    }
    all
}

impl Levers {
    fn new(kinematics: &Kinematics, posed: &Posed, triples: &[Triple], table: &[f64], r: usize) -> Self {
        let below = accumulated(kinematics, posed, table, r);
        let row = |joint: usize, c: usize| &below[(4 * joint + c) * r..][..r];
        let height = triples.last().map_or(0, |t| t.row + if matches!(t.freedom, Freedom::Turn) { 3 } else { 1 });
        let mut rows = Mat::zeros(r, height);
        for t in triples {
            let weight = row(t.joint, 3);
            match t.freedom {
                Freedom::Slide => rows.col_as_slice_mut(t.row).copy_from_slice(weight),
                Freedom::Turn => {
                    let center = posed.centers[t.joint].to_array();
                    for (c, origin) in center.into_iter().enumerate() {
                        let target = rows.col_as_slice_mut(t.row + c);
                        for ((m, x), w) in target.iter_mut().zip(row(t.joint, c)).zip(weight) {
                            *m = x - origin * w;
                        }
                    }
                }
            }
        }
        let axes = triples
            .iter()
            .map(|t| match t.freedom {
                Freedom::Turn => posed.transforms[t.joint].matrix3,
                Freedom::Slide => kinematics.slide_axes(posed, t.joint),
            })
            .collect();
        Self { rows, axes }
    }

    fn vector(&self, row: usize, k: usize) -> DVec3 {
        DVec3::new(self.rows[(k, row)], self.rows[(k, row + 1)], self.rows[(k, row + 2)])
    }

    /// Half the energy's gradient: ω·Σ m × p for turns, v·Σ w p for slides, p = G-weighted pull of each pseudo-anchor.
    fn add_gradient(&self, triples: &[Triple], pull: &[DVec3], gradient: &mut [f64]) {
        for (t, axes) in triples.iter().zip(&self.axes) {
            let along: DVec3 = match t.freedom {
                Freedom::Turn => pull.iter().enumerate().map(|(k, p)| self.vector(t.row, k).cross(*p)).sum(),
                Freedom::Slide => pull.iter().enumerate().map(|(k, p)| *p * self.rows[(k, t.row)]).sum(),
            };
            let g = (axes.transpose() * along).to_array();
            gradient[t.parameter..t.parameter + 3].iter_mut().zip(g).for_each(|(a, b)| *a += b);
        }
    }
}

/// Σ over each joint and all below it of the posed shares: [joint][x, y, z, weight][pseudo-anchor].
fn accumulated(kinematics: &Kinematics, posed: &Posed, table: &[f64], r: usize) -> Vec<f64> {
    let mut sums = table.to_vec();
    for (joint, t) in posed.transforms.iter().enumerate() {
        let own = &table[4 * joint * r..][..4 * r];
        let (xs, rest) = own.split_at(r);
        let (ys, rest) = rest.split_at(r);
        let (zs, ws) = rest.split_at(r);
        for c in 0..3 {
            let (line, shift) = (t.matrix3.row(c), t.translation[c]);
            let target = &mut sums[(4 * joint + c) * r..][..r];
            for k in 0..r {
                target[k] = line.x * xs[k] + line.y * ys[k] + line.z * zs[k] + shift * ws[k];
            }
        }
    }
    for joint in (0..kinematics.len()).rev() {
        if let Some(parent) = kinematics.parents[joint] {
            let (above, own) = sums.split_at_mut(4 * joint * r);
            above[4 * parent * r..][..4 * r].iter_mut().zip(&own[..4 * r]).for_each(|(a, b)| *a += b);
        }
    }
    sums
}

/// Adds scale · Jᵀ G J' to a block; `symmetric` when both are the same frame's and only the lower triangle is wanted.
fn add_product(
    triples: &[Triple],
    metric: &DMat3,
    later: &Levers,
    earlier: &Levers,
    symmetric: bool,
    scale: f64,
    block: &mut Mat<f64>,
) {
    let height = later.rows.ncols();
    let mut moments = Mat::zeros(height, height);
    matmul(moments.as_mut(), Accum::Replace, later.rows.transpose(), earlier.rows.as_ref(), scale, Par::Seq);
    for (b, u) in triples.iter().enumerate() {
        for (a, t) in triples.iter().enumerate().skip(if symmetric { b } else { 0 }) {
            let inner = match (t.freedom, u.freedom) {
                (Freedom::Turn, Freedom::Turn) => polarized_cofactor(
                    metric,
                    &DMat3::from_cols(
                        column(&moments, t.row, u.row),
                        column(&moments, t.row, u.row + 1),
                        column(&moments, t.row, u.row + 2),
                    ),
                ),
                (Freedom::Turn, Freedom::Slide) => skew(column(&moments, t.row, u.row)) * *metric,
                (Freedom::Slide, Freedom::Turn) => {
                    let q = DVec3::from_array([0, 1, 2].map(|c| moments[(t.row, u.row + c)]));
                    *metric * skew(-q)
                }
                (Freedom::Slide, Freedom::Slide) => *metric * moments[(t.row, u.row)],
            };
            let product = later.axes[a].transpose() * inner * earlier.axes[b];
            for c in 0..3 {
                let target = &mut block.col_as_slice_mut(u.parameter + c)[t.parameter..t.parameter + 3];
                target.iter_mut().zip(product.col(c).to_array()).for_each(|(x, y)| *x += y);
            }
        }
    }
}

fn column(m: &Mat<f64>, row: usize, column: usize) -> DVec3 {
    DVec3::from_slice(&m.col_as_slice(column)[row..row + 3])
}

/// ε ε G K: the bilinear form whose diagonal is twice the cofactor matrix.
fn polarized_cofactor(g: &DMat3, k: &DMat3) -> DMat3 {
    DMat3::from_cols(
        g.y_axis.cross(k.z_axis) + k.y_axis.cross(g.z_axis),
        g.z_axis.cross(k.x_axis) + k.z_axis.cross(g.x_axis),
        g.x_axis.cross(k.y_axis) + k.x_axis.cross(g.y_axis),
    )
}

//! Levenberg–Marquardt on SO(3)ᴶ × ℝ³ over many frames at once.
//!
//! Every frame contributes a dense block of normal equations; temporal smoothness couples it to its next two neighbours, so
//! the system is block-pentadiagonal in time and is solved by a block Cholesky factorisation (two frames a block).
//! Increments R ← R exp(δ); damping λ·diag(H), λ/5 on success, ×6 on failure.

use crate::normal::NormalEquations;
use crate::terms::{At, Context, Term};
use animimic_math::block_tridiagonal::BlockTridiagonal;
use animimic_rig::{Anchor, AnchorColumns, FramePose, Posed};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Temporal smoothness: Σ_t l₁ ‖ΔY‖² + l₂ ‖Δ²Y‖², Y the pseudo-anchors' positions (see `animimic_rig::smoothness`).
#[derive(Clone, Debug)]
pub struct Smoothness {
    /// Pseudo-anchors of all vertices.
    pub anchors: Vec<Anchor>,
    /// Their Jacobian structure.
    pub columns: Vec<AnchorColumns>,
    /// Weight l₁ of first differences [1/model unit²].
    pub velocity: f64,
    /// Weight l₂ of second differences [1/model unit²].
    pub acceleration: f64,
    /// Orthogonal directions in which motion is measured; a longer one damps motion along it more.
    pub basis: [DVec3; 3],
}

/// A fitting problem over a range of frames.
pub struct Problem<'a> {
    /// Tree, camera, anchors.
    pub context: Context<'a>,
    /// All terms, priors included.
    pub terms: Vec<&'a dyn Term>,
    /// Smoothness over time.
    pub smoothness: Option<&'a Smoothness>,
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Most iterations.
    pub max_iterations: usize,
    /// Stop when an accepted step lowers the energy by less than this share.
    pub tolerance: f64,
    /// First damping λ.
    pub damping: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { max_iterations: 40, tolerance: 1e-5, damping: 1e-2 }
    }
}

/// What a solve did.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Energy before and after each accepted step.
    pub energies: Vec<f64>,
}

const DAMPING_DOWN: f64 = 5.0;
const DAMPING_UP: f64 = 6.0;
const LEAST_DAMPING: f64 = 1e-7;
const MAX_REJECTIONS: usize = 8;
/// Added to every diagonal entry in the damping: parameters that nothing observes stay where they are.
const DIAGONAL_FLOOR: f64 = 1e-3;

/// Minimises the energy over the frames in `active`; poses outside it stay and hold their neighbours by smoothness.
pub fn solve(problem: &Problem, poses: &mut [FramePose], active: Range<usize>, options: &Options) -> Report {
    let mut posed: Vec<Posed> = poses.iter().map(|p| problem.context.kinematics.pose(p)).collect();
    let mut energy = total_energy(problem, poses, &posed, &active);
    let mut report = Report { energies: vec![energy] };
    let mut damping = options.damping;
    for _ in 0..options.max_iterations {
        let model = linearize(problem, poses, &posed, &active);
        let mut accepted = None;
        for _ in 0..MAX_REJECTIONS {
            if let Some(step) = model.step(damping) {
                let trial = retract(problem, poses, &active, &step);
                let trial_posed: Vec<Posed> = pose_all(problem, &trial, &posed, &active);
                let trial_energy = total_energy(problem, &trial, &trial_posed, &active);
                if trial_energy < energy {
                    accepted = Some((trial, trial_posed, trial_energy));
                    break;
                }
            }
            damping *= DAMPING_UP;
        }
        let Some((trial, trial_posed, trial_energy)) = accepted else { break };
        let gain = (energy - trial_energy) / energy.abs().max(1e-300);
        poses.clone_from_slice(&trial);
        (posed, energy) = (trial_posed, trial_energy);
        damping = (damping / DAMPING_DOWN).max(LEAST_DAMPING);
        report.energies.push(energy);
        if gain < options.tolerance {
            break;
        }
    }
    report
}

/// Energy of the active frames, with the smoothness that ties them to their neighbours.
pub fn total_energy(problem: &Problem, poses: &[FramePose], posed: &[Posed], active: &Range<usize>) -> f64 {
    let frames: Vec<f64> = active
        .clone()
        .into_par_iter()
        .map(|t| {
            let at = At { frame: t, pose: &poses[t], posed: &posed[t] };
            problem.terms.iter().map(|term| term.energy(&problem.context, &at)).sum::<f64>()
        })
        .collect();
    frames.iter().sum::<f64>() + problem.smoothness.map_or(0.0, |s| s.energy(posed, active))
}

fn retract(problem: &Problem, poses: &[FramePose], active: &Range<usize>, step: &[f64]) -> Vec<FramePose> {
    let mut moved = poses.to_vec();
    let d = problem.context.kinematics.dimension;
    for (k, t) in active.clone().enumerate() {
        moved[t] = problem.context.kinematics.retract(&poses[t], &step[k * d..(k + 1) * d]);
    }
    moved
}

fn pose_all(problem: &Problem, poses: &[FramePose], old: &[Posed], active: &Range<usize>) -> Vec<Posed> {
    let mut posed = old.to_vec();
    for t in active.clone() {
        posed[t] = problem.context.kinematics.pose(&poses[t]);
    }
    posed
}

/// The Gauss–Newton model of the active frames.
pub struct Model {
    dimension: usize,
    /// Diagonal blocks, lower triangles valid.
    diagonal: Vec<Mat<f64>>,
    /// `next[t]` = block (t + 1, t); `after_next[t]` = block (t + 2, t).
    next: Vec<Mat<f64>>,
    after_next: Vec<Mat<f64>>,
    /// Half the energy's gradient, \[frame · dimension\].
    pub gradient: Vec<f64>,
}

/// Linearises all terms at the given poses.
pub fn linearize(problem: &Problem, poses: &[FramePose], posed: &[Posed], active: &Range<usize>) -> Model {
    let d = problem.context.kinematics.dimension;
    let normals: Vec<NormalEquations> = active
        .clone()
        .into_par_iter()
        .map(|t| {
            let at = At { frame: t, pose: &poses[t], posed: &posed[t] };
            let mut normal = NormalEquations::zeros(d);
            problem.terms.iter().for_each(|term| term.linearize(&problem.context, &at, &mut normal));
            normal
        })
        .collect();
    let n = normals.len();
    let mut model = Model {
        dimension: d,
        diagonal: normals.iter().map(|e| MatRef::from_row_major_slice(&e.hessian, d, d).to_owned()).collect(),
        next: vec![Mat::zeros(d, d); n.saturating_sub(1)],
        after_next: vec![Mat::zeros(d, d); n.saturating_sub(2)],
        gradient: normals.iter().flat_map(|e| e.gradient.iter().copied()).collect(),
    };
    if let Some(s) = problem.smoothness {
        s.linearize(problem, posed, active, &mut model);
    }
    model
}

impl Model {
    /// The damped Gauss–Newton step, or `None` if the damped matrix is not positive definite.
    pub fn step(&self, damping: f64) -> Option<Vec<f64>> {
        let (d, n) = (self.dimension, self.diagonal.len());
        let sizes: Vec<usize> = (0..n).step_by(2).map(|t| if t + 1 < n { 2 * d } else { d }).collect();
        let mut system = BlockTridiagonal::zeros(&sizes);
        for t in 0..n {
            let (block, offset) = (t / 2, (t % 2) * d);
            let mut target = system.diagonal[block].as_mut().submatrix_mut(offset, offset, d, d);
            target.copy_from(&self.diagonal[t]);
            for i in 0..d {
                target[(i, i)] += damping * (target[(i, i)] + DIAGONAL_FLOOR);
            }
            for (later, coupling) in [(t + 1, &self.next), (t + 2, &self.after_next)] {
                let Some(source) = coupling.get(t).filter(|_| later < n) else { continue };
                let (row, row_offset) = (later / 2, (later % 2) * d);
                let target = if row == block { &mut system.diagonal[block] } else { &mut system.below[block] };
                target.as_mut().submatrix_mut(row_offset, offset, d, d).copy_from(source);
            }
        }
        let b: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        system.solve(&b).ok()
    }

    /// Diagonal of H, \[frame · dimension\]: the information about each parameter taken alone.
    pub fn information(&self) -> Vec<f64> {
        self.diagonal.iter().flat_map(|m| (0..m.nrows()).map(|i| m[(i, i)])).collect()
    }
}

impl Smoothness {
    /// Differences that touch an active frame: (first frame, coefficients over consecutive frames, weight).
    fn stencils(&self, frames: usize, active: &Range<usize>) -> Vec<(usize, &'static [f64], f64)> {
        let first = (0..frames.saturating_sub(1)).map(|t| (t, [-1.0, 1.0].as_slice(), self.velocity));
        let second = (0..frames.saturating_sub(2)).map(|t| (t, [1.0, -2.0, 1.0].as_slice(), self.acceleration));
        let touches = |t: usize, len: usize| t < active.end && t + len > active.start;
        first.chain(second).filter(|(t, c, w)| *w > 0.0 && touches(*t, c.len())).collect()
    }

    /// Directions of equal weight along all axes but one, which counts `stretch` times as much.
    pub fn stretched_basis(axis: DVec3, stretch: f64) -> [DVec3; 3] {
        let axis = axis.normalize();
        let (a, b) = axis.any_orthonormal_pair();
        [a, b, axis * stretch]
    }

    /// Coordinates of the pseudo-anchors along the basis.
    fn positions(&self, posed: &Posed) -> Vec<DVec3> {
        let along = |p: DVec3| DVec3::from_array(self.basis.map(|b| b.dot(p)));
        self.anchors.iter().map(|a| along(a.position(posed))).collect()
    }

    /// The energy of all differences that touch an active frame. Frames after the active range take no part: when tracking
    /// forward they do not exist yet.
    fn energy(&self, posed: &[Posed], active: &Range<usize>) -> f64 {
        let low = active.start.saturating_sub(2);
        let frames = active.end;
        let y: Vec<Vec<DVec3>> = (low..frames).into_par_iter().map(|t| self.positions(&posed[t])).collect();
        self.stencils(frames, active)
            .into_iter()
            .map(|(t, c, w)| {
                let square = |k: usize| -> f64 {
                    c.iter().enumerate().map(|(i, a)| y[t + i - low][k] * *a).sum::<DVec3>().length_squared()
                };
                w * (0..self.anchors.len()).map(square).sum::<f64>()
            })
            .sum()
    }

    fn linearize(&self, problem: &Problem, posed: &[Posed], active: &Range<usize>, model: &mut Model) {
        let (d, r) = (model.dimension, self.anchors.len());
        let low = active.start.saturating_sub(2);
        let frames = active.end;
        let y: Vec<Vec<DVec3>> = (low..frames).into_par_iter().map(|t| self.positions(&posed[t])).collect();
        // ∂Y/∂θ of each active frame, (3r) × d.
        let jacobians: Vec<Mat<f64>> =
            active.clone().into_par_iter().map(|t| self.jacobian(problem, &posed[t], d)).collect();
        let n = jacobians.len();
        // Q = Σ w c cᵀ over the stencils; (Q Y) drives the gradient, Q's bands the Hessian.
        let mut band = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        let mut pull = vec![vec![DVec3::ZERO; r]; n];
        for (t, c, w) in self.stencils(frames, active) {
            let difference: Vec<DVec3> =
                (0..r).map(|k| c.iter().enumerate().map(|(i, a)| y[t + i - low][k] * *a).sum()).collect();
            for (i, a) in c.iter().enumerate() {
                let Some(row) = (t + i).checked_sub(active.start).filter(|&s| s < n) else { continue };
                pull[row].iter_mut().zip(&difference).for_each(|(p, v)| *p += *v * (w * a));
                for (j, b) in c.iter().enumerate().filter(|(j, _)| *j <= i) {
                    if t + j >= active.start {
                        band[i - j][t + j - active.start] += w * a * b;
                    }
                }
            }
        }
        let product = |a: &Mat<f64>, b: &Mat<f64>, scale: f64, target: &mut Mat<f64>| {
            matmul(target.as_mut(), Accum::Add, a.transpose(), b.as_ref(), scale, Par::Seq);
        };
        model
            .diagonal
            .par_iter_mut()
            .enumerate()
            .for_each(|(s, m)| product(&jacobians[s], &jacobians[s], band[0][s], m));
        model
            .next
            .par_iter_mut()
            .enumerate()
            .for_each(|(s, m)| product(&jacobians[s + 1], &jacobians[s], band[1][s], m));
        model
            .after_next
            .par_iter_mut()
            .enumerate()
            .for_each(|(s, m)| product(&jacobians[s + 2], &jacobians[s], band[2][s], m));
        for (s, (jacobian, pulls)) in jacobians.iter().zip(&pull).enumerate() {
            let flat: Vec<f64> = pulls.iter().flat_map(|p| p.to_array()).collect();
            let g = jacobian.transpose() * MatRef::from_column_major_slice(&flat, 3 * r, 1);
            (0..d).for_each(|i| model.gradient[s * d + i] += g[(i, 0)]);
        }
    }

    fn jacobian(&self, problem: &Problem, posed: &Posed, dimension: usize) -> Mat<f64> {
        let mut jacobian = Mat::zeros(3 * self.anchors.len(), dimension);
        let mut row = Vec::new();
        for (k, (anchor, columns)) in self.anchors.iter().zip(&self.columns).enumerate() {
            for (axis, direction) in self.basis.into_iter().enumerate() {
                row.clear();
                anchor.push_row(columns, problem.context.kinematics, posed, direction, &mut row);
                for &(i, v) in &row {
                    jacobian[(3 * k + axis, i)] += v;
                }
            }
        }
        jacobian
    }
}

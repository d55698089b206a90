//! Stiffness from what is seen: Gauss–Newton on ln E through forward sensitivities.
//!
//! r_i(ln E, α) = n_i · x_i − d_i over surface points, minimise Σ w_i r_i²/s² + Σ_c (ln E_c − ln E_c⁰)²/σ², s² the residuals' own
//! variance (re-estimated), σ the width of the prior. The columns of the Jacobian are ∂x/∂ln E through the embedding, and one
//! difference quotient for the damping α. The inverse of the normal matrix is the posterior: what the evidence does not
//! determine stays at the prior with a deviation of σ.

use super::{Simulated, Stepping, Tissue};
use crate::FitError;
use animimic_scene::Pose;
use animimic_sim::{Elasticity, Sensitivities, sensitivities};
use glam::{DAffine3, DVec3};
use rayon::prelude::*;

/// One scalar comparison of the surface with what is seen.
#[derive(Clone, Copy, Debug)]
pub struct Residual {
    /// r: model less observation, in the evidence's unit.
    pub value: f64,
    /// w.
    pub weight: f64,
    /// ∂r/∂x for up to three vertices of the surface [unit / model unit].
    pub gradient: [(u32, DVec3); 3],
}

/// What is known of the surface.
pub trait Evidence: Sync {
    /// Residuals of a frame's surface [model unit].
    fn residuals(&self, frame: usize, surface: &[DVec3]) -> Vec<Residual>;
}

/// Known positions of some vertices.
pub struct Positions<'a> {
    /// Positions \[frame\]\[vertex\] [model unit].
    pub frames: &'a [Vec<DVec3>],
    /// Weight of each vertex; 0 leaves it out.
    pub weights: &'a [f64],
}

impl Evidence for Positions<'_> {
    fn residuals(&self, frame: usize, surface: &[DVec3]) -> Vec<Residual> {
        let Some(target) = self.frames.get(frame) else { return Vec::new() };
        let counted = (0..surface.len()).filter(|&v| self.weights[v] > 0.0);
        let of = |v: usize| {
            DVec3::AXES.map(|axis| Residual {
                value: axis.dot(surface[v] - target[v]),
                weight: self.weights[v],
                gradient: [(v as u32, axis), (v as u32, DVec3::ZERO), (v as u32, DVec3::ZERO)],
            })
        };
        counted.flat_map(of).collect()
    }
}

/// The motion that a material is fitted to.
pub struct Problem<'a, 'b> {
    /// The body.
    pub tissue: &'a Tissue<'b>,
    /// Poses of the joints.
    pub poses: &'a [Pose],
    /// Frames per second.
    pub fps: f64,
    /// What is known.
    pub evidence: &'a dyn Evidence,
    /// Steps per frame, constant: the loss must not jump.
    pub substeps: usize,
    /// Width of the prior of ln E, per cluster; a small one keeps what is known.
    pub prior_deviations: &'a [f64],
}

/// A fitted material.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The material.
    pub elasticity: Elasticity,
    /// Damping proportional to mass [1/s].
    pub mass_damping: f64,
    /// Posterior standard deviation of ln E, per cluster; that of the prior where nothing was learnt.
    pub deviations: Vec<f64>,
    /// Root mean square residual at the prior and after each accepted step.
    pub rms: Vec<f64>,
}

/// Largest change of ln E in a step.
const LARGEST_CHANGE: f64 = 1.5;
/// Change of the damping for its difference quotient [1/s].
const DAMPING_STEP: f64 = 0.25;
/// Width of the prior of the damping [1/s], around none.
const DAMPING_DEVIATION: f64 = 5.0;
/// Most damping [1/s]: it acts on velocities in the world, so much of it would hold back what is only carried along.
const MOST_DAMPING: f64 = 10.0;
/// ln E may leave the prior by this much: a factor of 1000 either way.
const RANGE: f64 = 7.0;
/// Dampings of the step tried before an iteration gives up.
const TRIES: usize = 6;
/// Steps that lower the rms by less than this share end the fit.
const SETTLED: f64 = 1e-4;
/// Changes of ln E of all clusters together that are tried first, and dampings with each [1/s].
const SCAN: ([f64; 5], [f64; 3]) = ([-2.5, -1.2, 0.0, 1.2, 2.5], [0.0, 2.0, 8.0]);

/// Clusters with a prior at least this wide take part in the scan.
const OPEN: f64 = 0.5;

/// A simulated motion with its comparison.
struct State {
    elasticity: Elasticity,
    damping: f64,
    simulated: Simulated,
    residuals: Vec<Vec<Residual>>,
}

impl State {
    /// Σ w r².
    fn squares(&self) -> f64 {
        self.residuals.iter().flatten().map(|r| r.weight * r.value * r.value).sum()
    }
}

impl Problem<'_, '_> {
    fn run(&self, elasticity: Elasticity, damping: f64) -> Result<State, FitError> {
        let stepping = Stepping { mass_damping: damping, tolerance: 1e-3, ..Stepping::default() };
        let start = self.tissue.start(&elasticity, &stepping, &self.poses[0])?;
        let simulated =
            self.tissue.simulate_from(start, &elasticity, &stepping, self.poses, self.fps, self.substeps)?;
        let cages: Vec<&Vec<DVec3>> = simulated.frames().collect();
        let residuals = (0..self.poses.len())
            .into_par_iter()
            .map(|t| {
                let world: Vec<DAffine3> = self.tissue.world(&self.poses[t]);
                self.evidence.residuals(t, &self.tissue.surface(cages[t], &world))
            })
            .collect();
        Ok(State { elasticity, damping, simulated, residuals })
    }

    /// Σ w r² of a material.
    ///
    /// # Errors
    /// As [`Tissue::simulate`].
    pub fn squares(&self, elasticity: &Elasticity, damping: f64) -> Result<f64, FitError> {
        Ok(self.run(elasticity.clone(), damping)?.squares())
    }

    /// Fits ln E of every cluster, around the given one, and the damping.
    ///
    /// # Errors
    /// As [`Tissue::simulate`]; no evidence at all.
    pub fn fit(&self, prior: &Elasticity, iterations: usize) -> Result<Estimate, FitError> {
        let positive = self.prior_deviations.iter().all(|d| *d > 0.0);
        if self.prior_deviations.len() != prior.ln_youngs.len() || !positive {
            return Err(FitError::Input("a prior needs one positive deviation for every cluster".into()));
        }
        let mut now = self.scan(prior)?;
        let count: f64 = now.residuals.iter().flatten().map(|r| r.weight).sum();
        if count <= 0.0 {
            return Err(FitError::Input("there is nothing to compare the soft surface with".into()));
        }
        let rms = |s: &State| (s.squares() / count).sqrt();
        let mut history = vec![rms(&now)];
        let mut damping = 1e-3;
        for _ in 0..iterations {
            let normal = self.normal(&now, prior, rms(&now))?;
            let before = self.objective(&now, prior, rms(&now));
            let scale = rms(&now);
            let mut moved = None;
            for _ in 0..TRIES {
                let step = normal.solve(damping);
                let largest = step[..prior.ln_youngs.len()].iter().fold(0.0f64, |m, d| m.max(d.abs()));
                let shrink = (LARGEST_CHANGE / largest.max(LARGEST_CHANGE)).min(1.0);
                let trial = self.run(
                    self.stepped(&now, prior, &step, shrink),
                    (now.damping - shrink * step[step.len() - 1]).clamp(0.0, MOST_DAMPING),
                )?;
                if self.objective(&trial, prior, scale) < before {
                    moved = Some(trial);
                    damping = (damping / 10.0).max(1e-9);
                    break;
                }
                damping *= 10.0;
            }
            let Some(next) = moved else { break };
            let gain = 1.0 - rms(&next) / rms(&now);
            now = next;
            history.push(rms(&now));
            if gain < SETTLED {
                break;
            }
        }
        let deviations = self.normal(&now, prior, rms(&now))?.deviations();
        Ok(Estimate {
            elasticity: now.elasticity,
            mass_damping: now.damping,
            deviations: deviations[..prior.ln_youngs.len()].to_vec(),
            rms: history,
        })
    }

    /// The best of a coarse grid around the prior: far away, linearised motions are no guide.
    fn scan(&self, prior: &Elasticity) -> Result<State, FitError> {
        let mut best: Option<State> = None;
        for damping in SCAN.1 {
            for change in SCAN.0 {
                let mut trial = prior.clone();
                let open = self.prior_deviations.iter().map(|d| f64::from(u8::from(*d >= OPEN)));
                trial.ln_youngs.iter_mut().zip(open).for_each(|(l, o)| *l += o * change);
                let state = self.run(trial, damping)?;
                if best.as_ref().is_none_or(|b| state.squares() < b.squares()) {
                    best = Some(state);
                }
            }
        }
        best.ok_or_else(|| FitError::Input("nothing was tried".into()))
    }

    fn stepped(&self, now: &State, prior: &Elasticity, step: &[f64], shrink: f64) -> Elasticity {
        let mut next = now.elasticity.clone();
        for ((l, d), p) in next.ln_youngs.iter_mut().zip(step).zip(&prior.ln_youngs) {
            *l = (*l - shrink * d).clamp(p - RANGE, p + RANGE);
        }
        next
    }

    /// Σ w r²/s² and the priors.
    fn objective(&self, state: &State, prior: &Elasticity, scale: f64) -> f64 {
        let away = |((a, b), d): ((&f64, &f64), &f64)| ((a - b) / d).powi(2);
        let pairs = state.elasticity.ln_youngs.iter().zip(&prior.ln_youngs).zip(self.prior_deviations);
        let material: f64 = pairs.map(away).sum();
        state.squares() / (scale * scale).max(f64::MIN_POSITIVE)
            + material
            + (state.damping / DAMPING_DEVIATION).powi(2)
    }

    /// Normal equations at a state; the last parameter is the damping.
    fn normal(&self, now: &State, prior: &Elasticity, scale: f64) -> Result<Normal, FitError> {
        let clusters = prior.ln_youngs.len();
        let columns =
            sensitivities(&self.tissue.body, &now.elasticity, &now.simulated.settings, &now.simulated.simulation)?;
        let shaken = self.run(now.elasticity.clone(), now.damping + DAMPING_STEP)?;
        let mut normal = Normal::zeros(clusters + 1);
        let weight = 1.0 / (scale * scale).max(f64::MIN_POSITIVE);
        let fields = self.surface_columns(&columns, clusters);
        for (t, residuals) in now.residuals.iter().enumerate() {
            for (i, r) in residuals.iter().enumerate() {
                let mut row = vec![0.0; clusters + 1];
                if t > 0 {
                    for (c, value) in row[..clusters].iter_mut().enumerate() {
                        let field = &fields[t - 1][c];
                        *value = r.gradient.iter().map(|(v, g)| g.dot(field[*v as usize])).sum();
                    }
                }
                // Evidence lists the same residuals for neighbouring motions; where it does not, it says nothing of damping.
                let other = shaken.residuals[t].get(i).map_or(r.value, |s| s.value);
                row[clusters] = (other - r.value) / DAMPING_STEP;
                normal.add(&row, r.value, weight * r.weight);
            }
        }
        for c in 0..clusters {
            let away = now.elasticity.ln_youngs[c] - prior.ln_youngs[c];
            normal.add_prior(c, away, self.prior_deviations[c]);
        }
        normal.add_prior(clusters, now.damping, DAMPING_DEVIATION);
        Ok(normal)
    }

    /// ∂(surface)/∂ln E [model unit], \[frame − 1\]\[cluster\]\[vertex\].
    fn surface_columns(&self, columns: &Sensitivities, clusters: usize) -> Vec<Vec<Vec<DVec3>>> {
        let body = &self.tissue.body;
        let ends: Vec<&Vec<Vec<f64>>> = columns.frames.iter().skip(self.substeps - 1).step_by(self.substeps).collect();
        ends.into_par_iter()
            .map(|frame| {
                (0..clusters)
                    .map(|c| {
                        let mut cage = vec![DVec3::ZERO; body.rest.len()];
                        for (&v, d) in body.free.iter().zip(frame[c].as_chunks::<3>().0) {
                            cage[v as usize] = DVec3::from_array(*d) / self.tissue.scale;
                        }
                        let embedded = |(tet, b): &([u32; 4], [f64; 4])| -> DVec3 {
                            tet.iter().zip(b).map(|(&k, b)| cage[k as usize] * *b).sum()
                        };
                        self.tissue.skinning.corners.iter().map(embedded).collect()
                    })
                    .collect()
            })
            .collect()
    }
}

/// JᵀWJ and JᵀWr of a few parameters.
struct Normal {
    matrix: Vec<Vec<f64>>,
    gradient: Vec<f64>,
}

impl Normal {
    fn zeros(n: usize) -> Self {
        Self { matrix: vec![vec![0.0; n]; n], gradient: vec![0.0; n] }
    }

    fn add(&mut self, row: &[f64], residual: f64, weight: f64) {
        for (i, a) in row.iter().enumerate() {
            self.gradient[i] += weight * a * residual;
            row.iter().zip(&mut self.matrix[i]).for_each(|(b, m)| *m += weight * a * b);
        }
    }

    fn add_prior(&mut self, i: usize, away: f64, deviation: f64) {
        let weight = deviation.powi(-2);
        self.matrix[i][i] += weight;
        self.gradient[i] += weight * away;
    }

    /// (N + damping diag N)⁻¹ g by Cholesky; N has a prior on every diagonal entry, so it is positive definite.
    fn solve(&self, damping: f64) -> Vec<f64> {
        let mut m = self.matrix.clone();
        (0..m.len()).for_each(|i| m[i][i] *= 1.0 + damping);
        solve(&m, &self.gradient)
    }

    /// Square roots of the diagonal of N⁻¹.
    fn deviations(&self) -> Vec<f64> {
        let n = self.gradient.len();
        let unit = |i: usize| (0..n).map(|j| f64::from(u8::from(i == j))).collect::<Vec<_>>();
        (0..n).map(|i| solve(&self.matrix, &unit(i))[i].max(0.0).sqrt()).collect()
    }
}

/// Solves a small symmetric positive definite system.
fn solve(matrix: &[Vec<f64>], rhs: &[f64]) -> Vec<f64> {
    let n = rhs.len();
    let (mut l, mut x) = (matrix.to_vec(), rhs.to_vec());
    for i in 0..n {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
            l[i][j] = if i == j { (l[i][i] - sum).max(f64::MIN_POSITIVE).sqrt() } else { (l[i][j] - sum) / l[j][j] };
        }
        let sum: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i][i];
    }
    for i in (0..n).rev() {
        let sum: f64 = (i + 1..n).map(|k| l[k][i] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i][i];
    }
    x
}

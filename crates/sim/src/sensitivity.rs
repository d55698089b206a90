//! Forward sensitivities of a motion to the moduli of its clusters, and Gauss–Newton on them.
//!
//! S = ∂x/∂ln E_c and W = ∂v/∂ln E_c follow each step with the factor of its true Hessian A:
//!     A S⁺ = M((1 + hα) S + h W) − h² (∂f/∂ln E_c + ∂f/∂xⁿ S),    W⁺ = (S⁺ − S)/h,
//! where f, the internal force, owes something to xⁿ only through the stiffness damping.
//! With few clusters this gives the whole Jacobian for one factorisation and K solves a step.

use crate::assembly;
use crate::body::Body;
use crate::elasticity::Elasticity;
use crate::error::{SimError, check_len};
use crate::filter::Eigenvalues;
use crate::settings::{Settings, State};
use crate::stepper::Stepper;
use crate::trajectory::{Simulation, simulate};
use glam::DVec3;

/// ∂x/∂ln E_c at frame ends, on the free vertices.
#[derive(Clone, Debug, Default)]
pub struct Sensitivities {
    /// \[frame\]\[cluster\]\[3 × free vertex\] \[m\], free vertices in `Body::free` order.
    pub frames: Vec<Vec<Vec<f64>>>,
    /// Steps whose Hessian was indefinite, where sensitivities stop being those of a minimum.
    pub indefinite_steps: Vec<usize>,
    /// Steps whose linear systems missed their tolerance.
    pub unsolved_steps: Vec<usize>,
}

/// Sensitivities of a simulation's frames to ln E of every cluster.
pub fn sensitivities(
    body: &Body,
    elasticity: &Elasticity,
    settings: &Settings,
    simulation: &Simulation,
) -> Result<Sensitivities, SimError> {
    let mut stepper = Stepper::new(body, elasticity, settings)?;
    let (clusters, size) = (elasticity.ln_youngs.len(), 3 * body.free.len());
    let h = settings.step_time();
    let mut s = vec![vec![0.0; size]; clusters];
    let mut w = s.clone();
    let mut result = Sensitivities::default();
    for (n, end) in simulation.steps.iter().enumerate() {
        let start = simulation.state(n, settings);
        let objective = stepper.objective(&start);
        stepper.assemble(&objective, end, Eigenvalues::True);
        let rhs = stepper.sensitivity_rhs(&start, end, &simulation.ends[n], &s, &w);
        let solved = stepper.solve_many(rhs);
        if solved.indefinite {
            result.indefinite_steps.push(n);
        }
        if solved.unsolved {
            result.unsolved_steps.push(n);
        }
        for (c, next) in solved.x.into_iter().enumerate() {
            (0..size).for_each(|i| w[c][i] = (next[i] - s[c][i]) / h);
            s[c] = next;
        }
        if (n + 1) % settings.substeps == 0 {
            result.frames.push(s.clone());
        }
    }
    Ok(result)
}

impl Stepper<'_> {
    /// M((1 + hα) S + h W) − h² (∂f/∂ln E_c + ∂f/∂xⁿ S) per cluster; of the internal force f only the damper knows xⁿ.
    fn sensitivity_rhs(
        &mut self,
        start: &State,
        end: &[DVec3],
        ends: &[DVec3],
        s: &[Vec<f64>],
        w: &[Vec<f64>],
    ) -> Vec<Vec<f64>> {
        let h = self.settings.step_time();
        let drag = 1.0 + h * self.settings.mass_damping;
        let mut scratch = std::mem::take(&mut self.scratch);
        let medium = self.medium(&start.positions);
        let mut forces = assembly::forces_by_cluster(&medium, &self.elasticity.cluster, s.len(), end);
        if medium.damper.is_some() {
            let mut viscous = vec![DVec3::ZERO; end.len()];
            for (force, s) in forces.iter_mut().zip(s) {
                let mut moved = vec![DVec3::ZERO; end.len()];
                self.add_free(&mut moved, 1.0, s);
                assembly::start_product(&medium, end, &moved, &mut scratch, &mut viscous);
                force.iter_mut().zip(&viscous).for_each(|(f, v)| *f += *v);
            }
        }
        self.scratch = scratch;
        self.add_tether_forces_by_cluster(end, ends, &mut forces);
        let rhs = |((force, s), w): ((&Vec<DVec3>, &Vec<f64>), &Vec<f64>)| {
            let entry = |(i, f): (usize, f64)| self.free_mass[i / 3] * (drag * s[i] + h * w[i]) - h * h * f;
            self.to_free(force).into_iter().enumerate().map(entry).collect()
        };
        forces.iter().zip(s).zip(w).map(rhs).collect()
    }
}

/// One iteration of [`gauss_newton`].
#[derive(Clone, Debug, PartialEq)]
pub struct GaussNewtonStep {
    /// ½ Σ |x − target|² over frames and free vertices [m²], before the iteration.
    pub loss: f64,
    /// ln E per cluster after it.
    pub ln_youngs: Vec<f64>,
    /// Frames it looked at.
    pub frames: usize,
    /// Simulations it took.
    pub simulations: usize,
}

/// Largest change of ln E in one iteration: a factor of 12, so that a bad linearisation cannot leave the physical range.
const LARGEST_CHANGE: f64 = 2.5;
/// Dampings tried before an iteration gives up.
const MAX_DAMPINGS: usize = 8;

/// Frames of the first horizon: long enough to move, short enough that a modulus 100 times off still bends the same way.
const FIRST_HORIZON: usize = 3;
/// Changes of ln E tried on the first horizon before the first iteration, for all clusters together and then for each alone:
/// where moduli are far off the clusters hide one another from Gauss–Newton (a stiff one moves nothing, a soft one carries
/// nothing on), and a scan of so few frames is cheap.
const SCAN: [f64; 6] = [-6.0, -4.0, -2.0, 2.0, 4.0, 6.0];
/// Clusters that are also scanned alone, at six short simulations each.
const MOST_SCANNED: usize = 16;
/// An iteration that changes ln E by less than this has settled its horizon.
const SETTLED: f64 = 0.5;

/// Fits ln E of every cluster to target positions (\[frame\]\[vertex\], m) by Levenberg–Marquardt on the forward sensitivities,
/// until ln E changes by less than `tolerance` or `iterations` are done. Returns the fitted material and the history.
///
/// A coarse scan comes first. Then the horizon grows: the first frames are fitted first and doubled whenever they have
/// settled, because the late frames of a motion with moduli far off are no guide at all.
pub fn gauss_newton(
    body: &Body,
    elasticity: &Elasticity,
    settings: &Settings,
    start: &State,
    path: &[Vec<DVec3>],
    targets: &[Vec<DVec3>],
    iterations: usize,
    tolerance: f64,
) -> Result<(Elasticity, Vec<GaussNewtonStep>), SimError> {
    check_len("target frames", targets.len(), path.len())?;
    let run = |material: &Elasticity, horizon: usize| -> Result<(Simulation, Vec<Vec<f64>>, f64), SimError> {
        let motion = simulate(body, material, settings, start, &path[..horizon])?;
        let pairs = motion.frames().zip(targets);
        let miss = |(x, t): (&Vec<DVec3>, &Vec<DVec3>)| {
            body.free.iter().flat_map(|&v| (x[v as usize] - t[v as usize]).to_array()).collect::<Vec<f64>>()
        };
        let residual: Vec<Vec<f64>> = pairs.map(miss).collect();
        let loss = 0.5 * residual.iter().flatten().map(|v| v * v).sum::<f64>();
        Ok((motion, residual, loss))
    };
    let mut horizon = FIRST_HORIZON.min(path.len());
    let mut now = elasticity.clone();
    let (mut motion, mut residual, mut loss) = run(&now, horizon)?;
    let clusters = now.ln_youngs.len();
    let alone = (0..clusters.min(MOST_SCANNED)).map(|c| c..c + 1).filter(|_| clusters > 1);
    for scanned in std::iter::once(0..clusters).chain(alone) {
        let first = now.clone();
        for exponent in SCAN {
            let mut trial = first.clone();
            trial.ln_youngs[scanned.clone()].iter_mut().for_each(|l| *l += exponent);
            let moved = run(&trial, horizon)?;
            if moved.2 < loss {
                now = trial;
                (motion, residual, loss) = moved;
            }
        }
    }
    let (mut damping, mut history) = (FIRST_DAMPING, vec![]);
    for _ in 0..iterations {
        let jacobian = sensitivities(body, &now, settings, &motion)?;
        let (normal, gradient) = normal_equations(&jacobian, &residual, now.ln_youngs.len());
        let before = loss;
        let (mut simulations, mut change) = (0, 0.0f64);
        for _ in 0..MAX_DAMPINGS {
            let delta = solve_damped(&normal, &gradient, damping);
            let largest = delta.iter().fold(0.0f64, |m, d| m.max(d.abs()));
            let shrink = (LARGEST_CHANGE / largest).min(1.0);
            let mut trial = now.clone();
            trial.ln_youngs.iter_mut().zip(&delta).for_each(|(l, d)| *l -= shrink * d);
            let moved = run(&trial, horizon)?;
            simulations += 1;
            if moved.2 < loss {
                change = shrink * largest;
                now = trial;
                (motion, residual, loss) = moved;
                damping = (damping / 10.0).max(1e-12);
                break;
            }
            damping *= 10.0;
        }
        history.push(GaussNewtonStep { loss: before, ln_youngs: now.ln_youngs.clone(), frames: horizon, simulations });
        if horizon < path.len() && change < SETTLED {
            horizon = (2 * horizon).min(path.len());
            (motion, residual, loss) = run(&now, horizon)?;
            damping = FIRST_DAMPING;
        } else if change < tolerance {
            break;
        }
    }
    Ok((now, history))
}

/// First damping, relative to the largest curvature of any cluster.
const FIRST_DAMPING: f64 = 1e-6;

/// JᵀJ and Jᵀr over all frames.
fn normal_equations(jacobian: &Sensitivities, residual: &[Vec<f64>], clusters: usize) -> (Vec<Vec<f64>>, Vec<f64>) {
    let (mut normal, mut gradient) = (vec![vec![0.0; clusters]; clusters], vec![0.0; clusters]);
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    for (columns, r) in jacobian.frames.iter().zip(residual) {
        for i in 0..clusters {
            gradient[i] += dot(&columns[i], r);
            for j in 0..=i {
                normal[i][j] += dot(&columns[i], &columns[j]);
            }
        }
    }
    for i in 0..clusters {
        for j in 0..i {
            normal[j][i] = normal[i][j];
        }
    }
    (normal, gradient)
}

/// (N + damping max(diag N) I) δ = g by dense Cholesky. The damping is the same for every cluster (Levenberg's, not
/// Marquardt's): a cluster that moves nothing yet stays where it is instead of running away.
fn solve_damped(normal: &[Vec<f64>], gradient: &[f64], damping: f64) -> Vec<f64> {
    let n = gradient.len();
    let largest = normal.iter().enumerate().map(|(i, r)| r[i]).fold(0.0, f64::max);
    let floor = largest * 1e-16 + f64::MIN_POSITIVE;
    let mut l = normal.to_vec();
    let mut x = gradient.to_vec();
    for i in 0..n {
        l[i][i] += damping * largest + floor;
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
            l[i][j] = if i == j { (l[i][i] - sum).max(floor).sqrt() } else { (l[i][j] - sum) / l[j][j] };
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

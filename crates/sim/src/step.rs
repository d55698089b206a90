//! One implicit step: Newton with the true Hessian and a backtracking line search.
//!
//! The Hessian is shifted by a multiple of the mass only where its Cholesky factorisation fails (Longva et al. 2023 compare
//! such strategies), clamped where no moderate shift is enough. Between factorisations the last factor preconditions
//! conjugate gradients on the present Hessian while that is the cheaper way to the same direction.

use crate::body::{Body, signed_volume};
use crate::elasticity::Elasticity;
use crate::error::{SimError, check_finite, check_len};
use crate::filter::{Eigenvalues, Filter};
use crate::settings::{Settings, State, StepReport};
use crate::stepper::{Assembled, Objective, Stepper};
use crate::tethers::check_ends;
use animimic_math::gradcheck::SplitMix64;
use animimic_math::sparse::krylov::Ended;
use glam::DVec3;

/// Sufficient decrease of the line search (Armijo's constant, Nocedal & Wright 2006, section 3.1).
const ARMIJO: f64 = 1e-4;
/// Halvings after which the line search gives up: 2⁻⁴⁰ is below the resolution of positions.
const MAX_CUTS: usize = 40;
/// Relative rounding noise of the objective; decreases below it cannot be told from zero.
const NOISE: f64 = 1e-13;
/// Mass shifts tried, each four times the last, before element Hessians are clamped instead.
const MAX_SHIFTS: usize = 5;
/// Largest relative error of an iterative Newton direction: the next iterate is not worth more digits.
const LOOSEST: f64 = 1e-2;
/// Saddle escapes allowed in one step.
const MAX_ESCAPES: usize = 8;
/// Inverse iterations for the most negative direction; it is separated by the shift, so few suffice.
const INVERSE_ITERATIONS: usize = 12;

/// What a Newton direction showed of the Hessian it was solved with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Inertia {
    /// Its factorisation succeeded.
    Definite,
    /// Its factorisation failed.
    Indefinite,
    /// Nothing: conjugate gradients met no negative curvature, which proves nothing.
    Unknown,
}

/// One step from `start` with `driven` positions at its end, see [`Stepper::step`].
pub fn step(
    body: &Body,
    elasticity: &Elasticity,
    settings: &Settings,
    start: &State,
    driven: &[DVec3],
) -> Result<(State, StepReport), SimError> {
    Stepper::new(body, elasticity, settings)?.step(start, driven)
}

impl Stepper<'_> {
    /// One step of length frame_time / substeps from `start`; `driven` are the driven vertices' positions [m] at its end,
    /// then those of the tethers' ends.
    ///
    /// Not reaching the tolerance is not an error but is in the report.
    pub fn step(&mut self, start: &State, driven: &[DVec3]) -> Result<(State, StepReport), SimError> {
        let n = self.body.rest.len();
        check_len("positions", start.positions.len(), n)?;
        check_len("velocities", start.velocities.len(), n)?;
        check_len("driven positions", driven.len(), self.body.driven.len() + self.body.tethers.len())?;
        check_finite("position", &start.positions)?;
        check_finite("velocity", &start.velocities)?;
        check_finite("driven position", driven)?;
        let (driven, ends) = driven.split_at(self.body.driven.len());
        check_ends(ends)?;
        let objective = Objective { ends, ..self.objective(start) };
        let mut report = StepReport::default();
        let (mut y, first) = self.first_guess(&objective, driven, &mut report);
        self.minimise(&objective, &mut y, first, &mut report);
        report.inverted = self.count_inverted(&y);
        let h = self.settings.step_time();
        let velocities = y.iter().zip(&start.positions).map(|(y, x)| (*y - *x) / h).collect();
        Ok((State { positions: y, velocities }, report))
    }

    pub(crate) fn eigenvalues(&self) -> Eigenvalues {
        match self.settings.filter {
            Filter::None | Filter::OnDemand => Eigenvalues::True,
            Filter::Clamp => Eigenvalues::Clamped,
            Filter::Absolute => Eigenvalues::Absolute,
        }
    }

    fn minimise(&mut self, objective: &Objective, y: &mut Vec<DVec3>, first: Assembled, report: &mut StepReport) {
        let eigenvalues = self.eigenvalues();
        let h = self.settings.step_time();
        let mut now = first;
        let mut speed = f64::INFINITY;
        while report.newton < self.settings.max_newton {
            let Some((dx, hessian)) = self.direction(objective, y, &now.gradient, speed, report) else { return };
            report.newton += 1;
            speed = dx.iter().fold(0.0f64, |m, d| m.max(d.abs())) / h;
            report.residual = speed;
            if !speed.is_finite() {
                return;
            }
            if speed < self.settings.tolerance {
                let mut last = y.clone();
                self.add_free(&mut last, 1.0, &dx);
                if self.keeps_upright(y, &last) {
                    *y = last;
                }
                report.converged = true;
                report.saddle = eigenvalues == Eigenvalues::True && self.is_indefinite(hessian);
                if !report.saddle || report.saddle_escapes == MAX_ESCAPES || self.settings.filter == Filter::None {
                    return;
                }
                if hessian == Inertia::Unknown && self.factorize_modified(objective, y, report).is_none() {
                    return;
                }
                match self.escape(objective, y, report) {
                    Some(next) => (now, speed, report.converged, report.saddle) = (next, f64::INFINITY, false, false),
                    None => return,
                }
                continue;
            }
            match self.advance(objective, y, &now, &dx, eigenvalues, report) {
                Some(next) => now = next,
                None => return,
            }
        }
    }

    /// −A⁻¹ G, and what that showed of A; none where the filter forbids modifying an indefinite A.
    fn direction(
        &mut self,
        objective: &Objective,
        y: &[DVec3],
        gradient: &[f64],
        last_speed: f64,
        report: &mut StepReport,
    ) -> Option<(Vec<f64>, Inertia)> {
        let negated = |g: &[f64]| -> Vec<f64> { g.iter().map(|v| -v).collect() };
        if self.factor.is_some() && last_speed.is_finite() {
            let wanted = (self.settings.tolerance / last_speed).clamp(1e-10, LOOSEST);
            let (dx, ended) = self.iterate(gradient, wanted, self.iteration_limit());
            if let Ended::Converged { iterations } = ended {
                report.conjugate_gradients += iterations;
                return Some((negated(&dx), Inertia::Unknown));
            }
        }
        report.factorizations += 1;
        let mut inertia = Inertia::Definite;
        if !self.factorize(0.0) {
            report.indefinite += 1;
            if self.settings.filter == Filter::None {
                return None;
            }
            inertia = Inertia::Indefinite;
            self.factorize_modified(objective, y, report)?;
        }
        let mut dx = negated(gradient);
        self.solve(&mut dx);
        Some((dx, inertia))
    }

    /// Shifts by growing multiples of the mass, then clamps the elements' eigenvalues.
    fn factorize_modified(&mut self, objective: &Objective, y: &[DVec3], report: &mut StepReport) -> Option<()> {
        let mut shift = self.shift_guess;
        for _ in 0..MAX_SHIFTS {
            report.factorizations += 1;
            if self.factorize(shift) {
                self.shift_guess = (shift / 4.0).max(0.05);
                return Some(());
            }
            shift *= 4.0;
        }
        self.assemble(objective, y, Eigenvalues::Clamped);
        report.factorizations += 1;
        self.factorize(0.0).then_some(())
    }

    /// Line search from y along dx; moves y and assembles there. None when no decrease can be found.
    fn advance(
        &mut self,
        objective: &Objective,
        y: &mut Vec<DVec3>,
        now: &Assembled,
        dx: &[f64],
        eigenvalues: Eigenvalues,
        report: &mut StepReport,
    ) -> Option<Assembled> {
        let slope: f64 = now.gradient.iter().zip(dx).map(|(g, d)| g * d).sum();
        let enough = |value: f64, a: f64| {
            value <= now.value + ARMIJO * a * slope || (value - now.value).abs() <= NOISE * now.value.abs()
        };
        let moved = |stepper: &Self, a: f64| {
            let mut trial = y.clone();
            stepper.add_free(&mut trial, a, dx);
            trial
        };
        // The full step is nearly always taken: assemble there at once instead of asking for the energy first.
        let full = moved(self, 1.0);
        let next = self.assemble(objective, &full, eigenvalues);
        if enough(next.value, 1.0) && self.keeps_upright(y, &full) {
            *y = full;
            return Some(next);
        }
        let mut a = 1.0;
        for _ in 0..MAX_CUTS {
            a *= 0.5;
            report.line_search_cuts += 1;
            let trial = moved(self, a);
            if self.keeps_upright(y, &trial) && enough(self.value(objective, &trial), a) {
                *y = trial;
                return Some(self.assemble(objective, y, eigenvalues));
            }
        }
        None
    }

    /// Whether no tet that is upright at `from` is inverted or flat at `to`, as far as the settings ask.
    fn keeps_upright(&self, from: &[DVec3], to: &[DVec3]) -> bool {
        let falls = |t: &[u32; 4]| signed_volume(to, t) <= 0.0 && signed_volume(from, t) > 0.0;
        !self.settings.upright || !self.body.tets.iter().any(falls)
    }

    /// Whether A is known or found to be indefinite. An iterative direction cannot tell by itself: what it solves for may have
    /// no part in an unstable mode. Then vᵀAv is looked at for the softest mode v, followed from step to step by one inverse
    /// iteration on the last factor, of a neighbouring matrix; the closer that is to singular, the faster v converges.
    fn is_indefinite(&mut self, known: Inertia) -> bool {
        if known != Inertia::Unknown {
            return known == Inertia::Indefinite;
        }
        let mut v = std::mem::take(&mut self.softest);
        let mut iterations = 1;
        if v.is_empty() {
            let mut rng = SplitMix64(0x50f7e57);
            v = (0..3 * self.free_mass.len()).map(|_| rng.normal()).collect();
            iterations = INVERSE_ITERATIONS;
        }
        (0..iterations).for_each(|_| self.inverse_iteration(&mut v));
        let curvature = self.curvature(&v);
        self.softest = v;
        curvature < 0.0
    }

    /// v ← P⁻¹ M v for the present factor P, normalised by the mass.
    fn inverse_iteration(&self, v: &mut [f64]) {
        v.iter_mut().enumerate().for_each(|(i, v)| *v *= self.free_mass[i / 3]);
        self.solve(v);
        let norm = v.iter().enumerate().map(|(i, v)| self.free_mass[i / 3] * v * v).sum::<f64>().sqrt();
        v.iter_mut().for_each(|v| *v /= norm);
    }

    /// vᵀAv.
    fn curvature(&self, v: &[f64]) -> f64 {
        let mut av = vec![0.0; v.len()];
        self.matrix.times_in_parts(&self.body.symbolic, v, &mut av);
        v.iter().zip(&av).map(|(v, a)| v * a).sum()
    }

    /// Pushes y out of a saddle along the most negative curvature; none where no descent was found.
    fn escape(&mut self, objective: &Objective, y: &mut Vec<DVec3>, report: &mut StepReport) -> Option<Assembled> {
        let now = self.assemble(objective, y, Eigenvalues::True);
        let mut rng = SplitMix64(0x5add1e);
        let mut v: Vec<f64> = now.gradient.iter().map(|_| rng.normal()).collect();
        // Inverse iteration on (A + βM)⁻¹ M converges to the lowest eigenvector of A relative to M.
        (0..INVERSE_ITERATIONS).for_each(|_| self.inverse_iteration(&mut v));
        let curvature = self.curvature(&v);
        if curvature >= 0.0 {
            return None;
        }
        let slope: f64 = v.iter().zip(&now.gradient).map(|(v, g)| v * g).sum();
        let sign = if slope > 0.0 { -1.0 } else { 1.0 };
        let largest = v.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        // From a tenth of the body's mean tet size down.
        let size = (self.body.volume.iter().sum::<f64>() / self.body.volume.len() as f64).cbrt();
        let mut a = 0.1 * size / largest;
        for _ in 0..MAX_CUTS {
            let mut trial = y.clone();
            self.add_free(&mut trial, sign * a, &v);
            if self.value(objective, &trial) < now.value + 0.1 * curvature * a * a {
                *y = trial;
                report.saddle_escapes += 1;
                return Some(self.assemble(objective, y, Eigenvalues::True));
            }
            a *= 0.5;
        }
        None
    }
}

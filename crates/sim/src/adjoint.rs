//! The adjoint of one step ([S] eqs 6–8), with damping and gravity.
//!
//! The step solves G(x⁺; xⁿ, vⁿ, p) = 0 on free vertices, G = M(x⁺ − x̃) + hαM(x⁺ − xⁿ) + h² f(x⁺) + hβ K(xⁿ)(x⁺ − xⁿ), and
//! v⁺ = (x⁺ − xⁿ)/h. With b = ∂L/∂x⁺ + (1/h) ∂L/∂v⁺ and A a = b on free rows (a = 0 on driven ones), A = ∂G/∂x⁺ the *true*
//! Hessian at the converged state:
//!     ∂L/∂p  = −aᵀ ∂G/∂p,      ∂L/∂xⁿ = −aᵀ ∂G/∂xⁿ − (1/h) ∂L/∂v⁺,      ∂L/∂vⁿ = h M a,
//!     ∂L/∂d⁺ = b_d − (A a)_d   for the driven positions at the step's end.
//! A filtered Hessian here gives gradients that are wrong by tens of percent. Where A is indefinite (a saddle) it is still
//! solved exactly, by MINRES on a shifted factor, and counted.

use crate::assembly;
use crate::body::Body;
use crate::elasticity::Elasticity;
use crate::error::{SimError, check_finite, check_len};
use crate::filter::Eigenvalues;
use crate::settings::{Settings, State};
use crate::stepper::Stepper;
use animimic_math::sparse::krylov::{Ended, minimum_residual};
use glam::DVec3;

/// Relative accuracy of iterative adjoint solves: far below the 1e-6 asked of gradients.
const ADJOINT_TOLERANCE: f64 = 1e-11;
/// MINRES iterations allowed on an indefinite matrix.
const MAX_MINRES: usize = 500;
/// Mass shifts tried on an indefinite matrix, each four times the last, from [`FIRST_SHIFT`].
const MAX_SHIFTS: i32 = 24;
/// First mass shift (in units of the mass).
const FIRST_SHIFT: f64 = 0.25;

/// ∂L/∂ everything one step depends on.
#[derive(Clone, Debug, Default)]
pub struct StepGradient {
    /// ∂L/∂(positions, velocities) at the step's start.
    pub d_start: State,
    /// ∂L/∂ driven positions at the step's end, per driven vertex, then per tether's end.
    pub d_driven: Vec<DVec3>,
    /// ∂L/∂ ln E, per cluster.
    pub d_ln_youngs: Vec<f64>,
    /// ∂L/∂ν.
    pub d_poisson: f64,
    /// ∂L/∂ρ [1/(kg/m³)].
    pub d_density: f64,
    /// ∂L/∂ gravity [1/(m/s²)].
    pub d_gravity: DVec3,
    /// ∂L/∂α, α the mass damping.
    pub d_mass_damping: f64,
    /// ∂L/∂β, β the stiffness damping; zero where β = 0.
    pub d_stiffness_damping: f64,
    /// Whether the Hessian at the step's end was indefinite.
    pub indefinite: bool,
    /// Whether the linear solve missed its tolerance.
    pub unsolved: bool,
}

/// ∂L/∂ everything a simulation depends on.
#[derive(Clone, Debug, Default)]
pub struct Gradient {
    /// ∂L/∂ initial positions and velocities. Initial positions of driven vertices are the start of their path.
    pub d_start: State,
    /// ∂L/∂ driven positions at frame ends, \[frame\]\[driven, tether\].
    pub d_path: Vec<Vec<DVec3>>,
    /// ∂L/∂ ln E, per cluster.
    pub d_ln_youngs: Vec<f64>,
    /// ∂L/∂ν.
    pub d_poisson: f64,
    /// ∂L/∂ρ [1/(kg/m³)].
    pub d_density: f64,
    /// ∂L/∂ gravity [1/(m/s²)].
    pub d_gravity: DVec3,
    /// ∂L/∂α.
    pub d_mass_damping: f64,
    /// ∂L/∂β.
    pub d_stiffness_damping: f64,
    /// Steps whose Hessian was indefinite at the end: stationary points that are not minima.
    pub indefinite_steps: Vec<usize>,
    /// Steps whose adjoint system missed its tolerance.
    pub unsolved_steps: Vec<usize>,
    /// Share of ∂L/∂ initial driven positions that comes from substeps of the first frame.
    d_path_start: Vec<DVec3>,
}

impl Gradient {
    pub(crate) fn zeros(body: &Body, elasticity: &Elasticity, frames: usize) -> Self {
        Self {
            d_path: vec![vec![DVec3::ZERO; body.driven.len() + body.tethers.len()]; frames],
            d_ln_youngs: vec![0.0; elasticity.ln_youngs.len()],
            d_path_start: vec![DVec3::ZERO; body.driven.len() + body.tethers.len()],
            ..Self::default()
        }
    }

    /// Adds one step's part; a substep's driven positions lie between two frames' and share their gradient.
    pub(crate) fn add_step(&mut self, part: &StepGradient, step: usize, substeps: usize) {
        let (frame, share) = (step / substeps, (step % substeps + 1) as f64 / substeps as f64);
        self.d_path[frame].iter_mut().zip(&part.d_driven).for_each(|(p, d)| *p += share * *d);
        let before = if frame == 0 { &mut self.d_path_start } else { &mut self.d_path[frame - 1] };
        before.iter_mut().zip(&part.d_driven).for_each(|(p, d)| *p += (1.0 - share) * *d);
        self.d_ln_youngs.iter_mut().zip(&part.d_ln_youngs).for_each(|(s, d)| *s += d);
        self.d_poisson += part.d_poisson;
        self.d_density += part.d_density;
        self.d_gravity += part.d_gravity;
        self.d_mass_damping += part.d_mass_damping;
        self.d_stiffness_damping += part.d_stiffness_damping;
        if part.indefinite {
            self.indefinite_steps.push(step);
        }
        if part.unsolved {
            self.unsolved_steps.push(step);
        }
    }

    /// The initial state's gradient, with the first frame's interpolated path.
    pub(crate) fn finish(&mut self, body: &Body, d_start: State) {
        self.d_start = d_start;
        for (&v, d) in body.driven.iter().zip(&self.d_path_start) {
            self.d_start.positions[v as usize] += *d;
        }
        for (t, d) in body.tethers.iter().zip(&self.d_path_start[body.driven.len()..]) {
            for (&v, b) in body.tets[t.tet as usize].iter().zip(t.barycentric) {
                self.d_start.positions[v as usize] += *d * b;
            }
        }
        self.indefinite_steps.reverse();
        self.unsolved_steps.reverse();
    }
}

/// Gradient of one step, see [`Stepper::step_vjp`].
pub fn step_vjp(
    body: &Body,
    elasticity: &Elasticity,
    settings: &Settings,
    start: &State,
    end: &[DVec3],
    ends: &[DVec3],
    d_end: &State,
) -> Result<StepGradient, SimError> {
    Stepper::new(body, elasticity, settings)?.step_vjp(start, end, ends, d_end)
}

impl Stepper<'_> {
    /// Pulls ∂L/∂(positions, velocities) at the end of a step back to what the step depended on. `end` are the positions
    /// that [`Stepper::step`] returned for `start`, `ends` those of the tethers' ends then.
    pub fn step_vjp(
        &mut self,
        start: &State,
        end: &[DVec3],
        ends: &[DVec3],
        d_end: &State,
    ) -> Result<StepGradient, SimError> {
        let n = self.body.rest.len();
        check_len("positions at the step's end", end.len(), n)?;
        check_len("ends of tethers", ends.len(), self.body.tethers.len())?;
        check_len("cotangents of positions", d_end.positions.len(), n)?;
        check_len("cotangents of velocities", d_end.velocities.len(), n)?;
        check_finite("cotangent of position", &d_end.positions)?;
        check_finite("cotangent of velocity", &d_end.velocities)?;
        let h = self.settings.step_time();
        let pairs = d_end.positions.iter().zip(&d_end.velocities);
        let b: Vec<DVec3> = pairs.map(|(x, v)| *x + *v / h).collect();
        let objective = self.objective(start);
        self.assemble(&objective, end, Eigenvalues::True);
        let solved = self.solve_adjoint(self.to_free(&b));
        let mut a = vec![DVec3::ZERO; n];
        self.add_free(&mut a, 1.0, &solved.x[0]);
        let mut scratch = std::mem::take(&mut self.scratch);
        let medium = self.medium(&start.positions);
        let c = assembly::contract(&medium, &self.lame_by_poisson, end, &a, &mut scratch);
        self.scratch = scratch;

        let mut result =
            StepGradient { indefinite: solved.indefinite, unsolved: solved.unsolved, ..StepGradient::default() };
        result.d_ln_youngs = vec![0.0; self.elasticity.ln_youngs.len()];
        for (cluster, v) in self.elasticity.cluster.iter().zip(&c.by_ln_youngs) {
            result.d_ln_youngs[*cluster as usize] -= h * h * v;
        }
        self.add_tethers_by_ln_youngs(&a, end, ends, h * h, &mut result.d_ln_youngs);
        result.d_poisson = -h * h * c.by_poisson;
        if self.settings.stiffness_damping > 0.0 {
            result.d_stiffness_damping = -h * h * c.by_damping / self.settings.stiffness_damping;
        }
        // a = 0 on driven rows, so M a and its kin vanish there by themselves.
        let drag = h * self.settings.mass_damping;
        result.d_start = State::at_rest(&vec![DVec3::ZERO; n]);
        for v in 0..n {
            let ma = self.mass[v] * a[v];
            let moved = end[v] - start.positions[v];
            let inertia = end[v] - objective.target[v] + drag * moved;
            result.d_density -= a[v].dot(inertia) * self.body.lumped_volume[v];
            result.d_gravity += h * h * ma;
            result.d_mass_damping -= h * ma.dot(moved);
            result.d_start.positions[v] = (1.0 + drag) * ma - d_end.velocities[v] / h;
            result.d_start.velocities[v] = h * ma;
        }
        for (d, f) in result.d_start.positions.iter_mut().zip(&c.by_start) {
            *d -= h * h * *f;
        }
        // A tether ties the driven corners of its tet to the free ones.
        let mut by_tethers = vec![DVec3::ZERO; n];
        self.add_tether_forces(&a, &vec![DVec3::ZERO; self.body.tethers.len()], &mut by_tethers);
        let pulled = |(&v, f): (&u32, &DVec3)| b[v as usize] - h * h * (*f + by_tethers[v as usize]);
        result.d_driven = self.body.driven.iter().zip(&c.on_driven).map(pulled).collect();
        result.d_driven.extend(self.tether_ends_vjp(&a, h * h));
        Ok(result)
    }

    /// A⁻¹ b with the true Hessian.
    fn solve_adjoint(&mut self, b: Vec<f64>) -> Solved {
        if b.iter().all(|v| *v == 0.0) {
            return Solved { x: vec![b], ..Solved::default() };
        }
        if std::mem::take(&mut self.factor_is_near) {
            let (a, ended) = self.iterate(&b, ADJOINT_TOLERANCE, self.iteration_limit());
            if matches!(ended, Ended::Converged { .. }) {
                return Solved { x: vec![a], ..Solved::default() };
            }
        }
        self.solve_many(vec![b])
    }

    /// A⁻¹ b for several right-hand sides, as in the adjoint: directly where A is positive definite, else by MINRES.
    pub(crate) fn solve_many(&mut self, mut rhs: Vec<Vec<f64>>) -> Solved {
        if self.factorize(0.0) {
            rhs.iter_mut().for_each(|b| self.solve(b));
            return Solved { x: rhs, ..Solved::default() };
        }
        let shifted = (0..MAX_SHIFTS).any(|n| self.factorize(FIRST_SHIFT * 4f64.powi(n)));
        if !shifted {
            // Only a matrix that is not finite gets here: the state it was assembled at is not.
            rhs.iter_mut().for_each(|b| b.fill(0.0));
            return Solved { x: rhs, indefinite: true, unsolved: true };
        }
        let factor = self.factor.as_ref().expect("factored above");
        let mut unsolved = false;
        for b in &mut rhs {
            let symbolic = &self.body.symbolic;
            let (a, ended) = minimum_residual(symbolic, factor, &self.matrix, b, ADJOINT_TOLERANCE, MAX_MINRES);
            unsolved |= !matches!(ended, Ended::Converged { .. });
            *b = a;
        }
        Solved { x: rhs, indefinite: true, unsolved }
    }
}

/// Solutions of linear systems with the true Hessian.
#[derive(Default)]
pub(crate) struct Solved {
    /// One per right-hand side.
    pub x: Vec<Vec<f64>>,
    /// Whether the Hessian was indefinite.
    pub indefinite: bool,
    /// Whether any solve missed its tolerance.
    pub unsolved: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::Filter;
    use crate::fixtures::column;
    use crate::models::Model;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};

    /// What one step of the column depends on, as one flat list: ln E per cluster, ν, start, driven ends.
    struct Inputs {
        elasticity: Elasticity,
        start: State,
        driven: Vec<DVec3>,
    }

    impl Inputs {
        fn parts(&mut self) -> impl Iterator<Item = &mut f64> {
            let fields = [&mut self.start.positions, &mut self.start.velocities, &mut self.driven];
            let fields = fields.into_iter().flatten().flat_map(|p| p.as_mut() as &mut [f64; 3]);
            self.elasticity.ln_youngs.iter_mut().chain([&mut self.elasticity.poisson]).chain(fields)
        }
    }

    #[test]
    fn the_adjoint_at_a_saddle_is_that_of_the_stationary_point() {
        // A straight column squeezed beyond buckling. Its stationary point is followed by plain Newton, which unlike a
        // descent stays on the saddle when the inputs push the column aside.
        let (mesh, ends) = column(6, 0.125);
        let body = Body::new(&mesh, &ends).expect("a good mesh");
        let cluster = (0..mesh.tets.len() as u32).map(|t| t % 2).collect();
        let ln_youngs = vec![2e5f64.ln(); 2];
        let material = Elasticity { model: Model::FixedCorotated, cluster, ln_youngs, poisson: 0.3, density: 1000.0 };
        let settings = Settings { frame_time: 0.2, filter: Filter::Clamp, tolerance: 1e-11, ..Settings::default() };
        let squeezed: Vec<DVec3> = mesh.positions.iter().map(|p| DVec3::new(0.75 * p.x, p.y, p.z)).collect();
        let driven: Vec<DVec3> = ends.iter().map(|&v| squeezed[v as usize]).collect();
        let mut inputs = Inputs { elasticity: material, start: State::at_rest(&squeezed), driven };
        let mut stepper = Stepper::new(&body, &inputs.elasticity, &settings).expect("good input");
        let (end, report) = stepper.step(&inputs.start, &inputs.driven).expect("good input");
        assert!(report.converged);

        let mut rng = SplitMix64(9);
        let mut random = || -> Vec<DVec3> {
            mesh.positions.iter().map(|_| DVec3::new(rng.normal(), rng.normal(), rng.normal())).collect()
        };
        let d_end = State { positions: random(), velocities: random() };
        let g = stepper.step_vjp(&inputs.start, &end.positions, &[], &d_end).expect("good input");
        assert!(g.indefinite && !g.unsolved, "the column is beyond buckling");
        let fields = [&g.d_start.positions, &g.d_start.velocities, &g.d_driven];
        let fields = fields.into_iter().flatten().flat_map(|p| p.to_array());
        let gradient: Vec<f64> = g.d_ln_youngs.iter().copied().chain([g.d_poisson]).chain(fields).collect();
        let x: Vec<f64> = inputs.parts().map(|p| *p).collect();
        let h = settings.step_time();
        let loss = |p: &[f64]| {
            inputs.parts().zip(p).for_each(|(part, p)| *part = *p);
            let mut stepper = Stepper::new(&body, &inputs.elasticity, &settings).expect("good input");
            let objective = stepper.objective(&inputs.start);
            let mut y = end.positions.clone();
            ends.iter().zip(&inputs.driven).for_each(|(&v, d)| y[v as usize] = *d);
            for _ in 0..8 {
                let now = stepper.assemble(&objective, &y, Eigenvalues::True);
                let solved = stepper.solve_many(vec![now.gradient]);
                assert!(solved.indefinite && !solved.unsolved);
                stepper.add_free(&mut y, -1.0, &solved.x[0]);
            }
            let pairs = y.iter().zip(&inputs.start.positions).zip(d_end.positions.iter().zip(&d_end.velocities));
            pairs.map(|((y, x), (dx, dv))| dx.dot(*y) + dv.dot((*y - *x) / h)).sum()
        };
        let error = gradient_error(loss, &x, &gradient, 6, &[1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7], 2);
        println!("gradient at a saddle: {error:.1e}");
        assert!(error < 1e-6);
    }
}

//! The implicit step as a minimisation problem: its value, gradient, Hessian and linear solves.
//!
//! x⁺ = argmin ½‖x − x̃‖²_M + (hα/2)‖x − xⁿ‖²_M + h² Ψ(x) + (hβ/2) (x − xⁿ)ᵀK(xⁿ)(x − xⁿ),  x̃ = xⁿ + h vⁿ + h² g
//! over the free vertices, driven ones being given ([S] eqs 1–5 with h² on Ψ; α, β and g are zero unless asked for).

use crate::assembly::{self, Medium, Scratch};
use crate::body::{Body, signed_volume};
use crate::elasticity::Elasticity;
use crate::element::Lame;
use crate::error::{SimError, check_len};
use crate::filter::Eigenvalues;
use crate::settings::{Settings, State};
use animimic_math::sparse::krylov::{Ended, conjugate_gradients};
use animimic_math::sparse::{BlockMatrix, Factor};
use glam::DVec3;
use std::sync::Arc;

/// Work that lives as long as a simulation: matrices, factors and buffers of one body and material.
pub struct Stepper<'a> {
    pub(crate) body: &'a Body,
    pub(crate) elasticity: &'a Elasticity,
    pub(crate) settings: &'a Settings,
    pub(crate) lame: Lame,
    pub(crate) lame_by_poisson: Lame,
    /// Lumped mass [kg], per vertex.
    pub(crate) mass: Vec<f64>,
    /// Mass of the free vertices in elimination order [kg].
    pub(crate) free_mass: Vec<f64>,
    /// Spring constants of the tethers [N/m].
    pub(crate) tether_stiffness: Vec<f64>,
    pub(crate) scratch: Scratch,
    /// M + hαM + h²∂²Ψ (+ damper) at the last assembled point.
    pub(crate) matrix: BlockMatrix,
    /// The last factor, of this or a neighbouring matrix.
    pub(crate) factor: Option<Arc<Factor>>,
    spare: Option<Factor>,
    /// Whether the factor belongs to (almost) the matrix about to be assembled.
    pub(crate) factor_is_near: bool,
    /// First mass shift to try when the Hessian is indefinite.
    pub(crate) shift_guess: f64,
    /// Approximation to the softest mode of the Hessian, in elimination order; empty until asked for.
    pub(crate) softest: Vec<f64>,
}

/// The fixed data of one step's minimisation.
pub(crate) struct Objective<'s> {
    pub start: &'s State,
    /// x̃, per vertex.
    pub target: Vec<DVec3>,
    /// Ends of the tethers; empty where only the Hessian is asked for.
    pub ends: &'s [DVec3],
}

/// Value and gradient at a point; the Hessian is in the stepper's matrix.
pub(crate) struct Assembled {
    pub value: f64,
    /// On free vertices, in elimination order.
    pub gradient: Vec<f64>,
}

impl<'a> Stepper<'a> {
    /// Checks the material against the body and allocates.
    pub fn new(body: &'a Body, elasticity: &'a Elasticity, settings: &'a Settings) -> Result<Self, SimError> {
        elasticity.validate(body.volume.len())?;
        settings.validate()?;
        let mass: Vec<f64> = body.lumped_volume.iter().map(|v| v * elasticity.density).collect();
        let per_tet = |unit: [f64; 2]| {
            let scaled =
                |u: f64| elasticity.cluster.iter().map(|&c| elasticity.ln_youngs[c as usize].exp() * u).collect();
            Lame { mu: scaled(unit[0]), lambda: scaled(unit[1]) }
        };
        Ok(Self {
            lame: per_tet(elasticity.unit_lame()),
            lame_by_poisson: per_tet(elasticity.unit_lame_by_poisson()),
            tether_stiffness: body
                .tethers
                .iter()
                .map(|t| t.stiffness * elasticity.ln_youngs[elasticity.cluster[t.tet as usize] as usize].exp())
                .collect(),
            free_mass: body.free.iter().map(|&v| mass[v as usize]).collect(),
            mass,
            scratch: Scratch::default(),
            matrix: BlockMatrix::zeros(body.pattern.clone()),
            factor: None,
            spare: None,
            factor_is_near: false,
            shift_guess: 0.25,
            softest: vec![],
            body,
            elasticity,
            settings,
        })
    }

    /// What sums over tets need; `start` are the positions at the step's start.
    pub(crate) fn medium<'m>(&'m self, start: &'m [DVec3]) -> Medium<'m> {
        let rate = self.settings.stiffness_damping / self.settings.step_time();
        Medium {
            body: self.body,
            model: self.elasticity.model,
            lame: &self.lame,
            damper: (rate > 0.0).then_some((start, rate)),
        }
    }

    pub(crate) fn objective<'s>(&self, start: &'s State) -> Objective<'s> {
        let h = self.settings.step_time();
        let pairs = start.positions.iter().zip(&start.velocities);
        Objective {
            target: pairs.map(|(x, v)| *x + h * *v + h * h * self.settings.gravity).collect(),
            start,
            ends: &[],
        }
    }

    /// Entries of a vertex field on the free vertices, in elimination order.
    pub(crate) fn to_free(&self, field: &[DVec3]) -> Vec<f64> {
        self.body.free.iter().flat_map(|&v| field[v as usize].to_array()).collect()
    }

    /// Adds `scale` × a solver vector to a vertex field.
    pub(crate) fn add_free(&self, field: &mut [DVec3], scale: f64, free: &[f64]) {
        for (&v, d) in self.body.free.iter().zip(free.as_chunks::<3>().0) {
            field[v as usize] += scale * DVec3::from_array(*d);
        }
    }

    /// Inertia and mass damping: their value, and their gradient in elimination order.
    fn inertia(&self, objective: &Objective, y: &[DVec3]) -> (f64, Vec<f64>) {
        let drag = self.settings.step_time() * self.settings.mass_damping;
        let mut value = 0.0;
        let mut gradient = Vec::with_capacity(3 * self.body.free.len());
        for (&v, m) in self.body.free.iter().zip(&self.free_mass) {
            let v = v as usize;
            let (a, b) = (y[v] - objective.target[v], y[v] - objective.start.positions[v]);
            value += 0.5 * m * (a.length_squared() + drag * b.length_squared());
            gradient.extend((m * (a + drag * b)).to_array());
        }
        (value, gradient)
    }

    /// The objective alone.
    pub(crate) fn value(&mut self, objective: &Objective, y: &[DVec3]) -> f64 {
        let h = self.settings.step_time();
        let mut scratch = std::mem::take(&mut self.scratch);
        let psi = assembly::energy(&self.medium(&objective.start.positions), y, &mut scratch);
        self.scratch = scratch;
        self.inertia(objective, y).0 + h * h * (psi + self.tether_energy(y, objective.ends))
    }

    /// Objective, gradient, and Hessian into `self.matrix`.
    pub(crate) fn assemble(&mut self, objective: &Objective, y: &[DVec3], filter: Eigenvalues) -> Assembled {
        let h = self.settings.step_time();
        let (mut scratch, mut matrix) = (std::mem::take(&mut self.scratch), std::mem::take(&mut self.matrix));
        let mut forces = vec![DVec3::ZERO; y.len()];
        let medium = self.medium(&objective.start.positions);
        let psi = assembly::hessian(&medium, y, filter, h * h, &mut scratch, &mut forces, &mut matrix);
        self.add_tether_forces(y, objective.ends, &mut forces);
        let drag = 1.0 + h * self.settings.mass_damping;
        for (p, m) in self.free_mass.iter().enumerate() {
            let diagonal = &mut matrix.blocks[matrix.pattern.column_start[p] as usize];
            (0..3).for_each(|c| diagonal[4 * c] += drag * m);
        }
        let (inertia, mut gradient) = self.inertia(objective, y);
        gradient.iter_mut().zip(self.to_free(&forces)).for_each(|(g, f)| *g += h * h * f);
        (self.scratch, self.matrix) = (scratch, matrix);
        self.add_tether_blocks(h * h);
        Assembled { value: inertia + h * h * (psi + self.tether_energy(y, objective.ends)), gradient }
    }

    /// Factors the assembled matrix, plus `shift` × mass. False where it is not positive definite.
    pub(crate) fn factorize(&mut self, shift: f64) -> bool {
        // The old factor's memory is reused unless somebody keeps it; a failed one is no preconditioner, only memory.
        let old = self.factor.take().and_then(Arc::into_inner).or(self.spare.take());
        let mut factor = old.unwrap_or_default();
        let shifts: Vec<f64> = if shift > 0.0 { self.free_mass.iter().map(|m| shift * m).collect() } else { vec![] };
        let done = factor.factor(&self.body.symbolic, &self.matrix, &shifts).is_ok();
        match done {
            true => self.factor = Some(Arc::new(factor)),
            false => self.spare = Some(factor),
        }
        done
    }

    /// A⁻¹ b with the present factor.
    pub(crate) fn solve(&self, b: &mut [f64]) {
        let factor = self.factor.as_ref().expect("factored before");
        factor.solve(&self.body.symbolic, b);
    }

    /// A⁻¹ b by conjugate gradients on the present factor.
    pub(crate) fn iterate(&self, b: &[f64], tolerance: f64, limit: usize) -> (Vec<f64>, Ended) {
        let factor = self.factor.as_ref().expect("factored before");
        conjugate_gradients(&self.body.symbolic, factor, &self.matrix, b, tolerance, limit)
    }

    /// Conjugate-gradient iterations that cost less than a factorisation: arithmetic against memory traffic.
    pub(crate) fn iteration_limit(&self) -> usize {
        let symbolic = &self.body.symbolic;
        let ratio = symbolic.factor_flops() / (FLOPS_PER_ENTRY * symbolic.factor_entries().max(1) as f64);
        (ratio as usize).clamp(2, 12)
    }

    /// Kinetic and elastic energy of a state [J]; gravity's potential is not included.
    pub fn energy(&mut self, state: &State) -> Result<f64, SimError> {
        check_len("positions", state.positions.len(), self.mass.len())?;
        check_len("velocities", state.velocities.len(), self.mass.len())?;
        let mut scratch = std::mem::take(&mut self.scratch);
        let medium = Medium { damper: None, ..self.medium(&state.positions) };
        let elastic = assembly::energy(&medium, &state.positions, &mut scratch);
        self.scratch = scratch;
        let kinetic: f64 = self.mass.iter().zip(&state.velocities).map(|(m, v)| 0.5 * m * v.length_squared()).sum();
        Ok(kinetic + elastic)
    }

    /// Tets with det F ≤ 0.
    pub(crate) fn count_inverted(&self, y: &[DVec3]) -> usize {
        self.body.tets.iter().filter(|t| signed_volume(y, t) <= 0.0).count()
    }
}

/// Factor operations that take as long as using one stored entry in a solve (measured: 25 GF/s against 0.6 G entries/s).
const FLOPS_PER_ENTRY: f64 = 40.0;

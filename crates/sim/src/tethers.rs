//! Tethers: points inside tets on strong springs, whose other ends follow prescribed paths.
//!
//! Ψ_t = Σ_p (k_p/2) ‖Σ_i b_pi x_i − d_p‖², k_p = E s_p with E the modulus of the tet that holds the point: a tether that is much
//! stiffer than the flesh around it would crush it. Driven vertices can only sit where a mesh has vertices; a tether holds any point, so a
//! bone can run through a coarse mesh. Its Hessian k b_i b_j I is constant and lies in the tet's own blocks.

use crate::body::Body;
use crate::error::{SimError, check_finite};
use crate::stepper::Stepper;
use glam::DVec3;

/// One tether.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tether {
    /// The tet that holds the point.
    pub tet: u32,
    /// Where in it.
    pub barycentric: [f64; 4],
    /// Spring constant over the tet's Young's modulus, s [m].
    pub stiffness: f64,
}

/// A Hessian block that a tether adds to: its index in the pattern, and b_i b_j.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TetherBlock {
    pub tether: u32,
    pub block: u32,
    pub value: f64,
}

impl Body {
    /// The same body with tethers; their paths are given after those of the driven vertices.
    ///
    /// # Errors
    /// A tether in no tet, or with numbers that are not finite.
    pub fn tethered(mut self, tethers: Vec<Tether>) -> Result<Self, SimError> {
        let mut position = vec![u32::MAX; self.rest.len()];
        self.free.iter().enumerate().for_each(|(p, &v)| position[v as usize] = p as u32);
        self.tether_blocks.clear();
        for (index, t) in tethers.iter().enumerate() {
            let Some(tet) = self.tets.get(t.tet as usize) else {
                return Err(SimError::Length {
                    what: "tets of a tether",
                    got: t.tet as usize,
                    expected: self.tets.len(),
                });
            };
            if !t.barycentric.iter().chain([&t.stiffness]).all(|v| v.is_finite()) {
                return Err(SimError::NotFinite { what: "tether", index });
            }
            for i in 0..4 {
                for j in 0..=i {
                    let (a, b) = (position[tet[i] as usize], position[tet[j] as usize]);
                    if a == u32::MAX || b == u32::MAX {
                        continue;
                    }
                    let block = self.pattern.find(a.max(b), a.min(b)).expect("both are corners of one tet") as u32;
                    let value = t.barycentric[i] * t.barycentric[j];
                    self.tether_blocks.push(TetherBlock { tether: index as u32, block, value });
                }
            }
        }
        self.tethers = tethers;
        Ok(self)
    }

    /// Where the tethered points are.
    pub fn tethered_points(&self, positions: &[DVec3]) -> Vec<DVec3> {
        self.tethers.iter().map(|t| self.point(t, positions)).collect()
    }

    fn point(&self, t: &Tether, positions: &[DVec3]) -> DVec3 {
        let corners = self.tets[t.tet as usize];
        corners.iter().zip(t.barycentric).map(|(&v, b)| positions[v as usize] * b).sum()
    }
}

impl Stepper<'_> {
    /// Energy of the tethers [J] with their ends at `ends`.
    pub(crate) fn tether_energy(&self, positions: &[DVec3], ends: &[DVec3]) -> f64 {
        let one = |((t, k), d): ((&Tether, &f64), &DVec3)| 0.5 * k * self.body.point(t, positions).distance_squared(*d);
        self.body.tethers.iter().zip(&self.tether_stiffness).zip(ends).map(one).sum()
    }

    /// Adds ∂Ψ_t/∂x to a field of forces.
    pub(crate) fn add_tether_forces(&self, positions: &[DVec3], ends: &[DVec3], forces: &mut [DVec3]) {
        for ((t, k), d) in self.body.tethers.iter().zip(&self.tether_stiffness).zip(ends) {
            let pull = *k * (self.body.point(t, positions) - *d);
            for (&v, b) in self.body.tets[t.tet as usize].iter().zip(t.barycentric) {
                forces[v as usize] += pull * b;
            }
        }
    }

    /// Adds h² ∂²Ψ_t to the matrix.
    pub(crate) fn add_tether_blocks(&mut self, h2: f64) {
        for t in &self.body.tether_blocks {
            let block = &mut self.matrix.blocks[t.block as usize];
            let value = h2 * self.tether_stiffness[t.tether as usize] * t.value;
            (0..3).for_each(|c| block[4 * c] += value);
        }
    }

    /// ∂L/∂(ends of the tethers) = h² k Σ b_i a_i for the adjoint a of the positions.
    pub(crate) fn tether_ends_vjp(&self, adjoint: &[DVec3], h2: f64) -> Vec<DVec3> {
        let one = |(t, k): (&Tether, &f64)| h2 * k * self.body.point(t, adjoint);
        self.body.tethers.iter().zip(&self.tether_stiffness).map(one).collect()
    }

    /// Adds the tethers' forces to those of the clusters that their stiffness is of, ∂(∂Ψ_t/∂x)/∂ln E.
    pub(crate) fn add_tether_forces_by_cluster(&self, positions: &[DVec3], ends: &[DVec3], forces: &mut [Vec<DVec3>]) {
        for ((t, k), d) in self.body.tethers.iter().zip(&self.tether_stiffness).zip(ends) {
            let field = &mut forces[self.elasticity.cluster[t.tet as usize] as usize];
            let pull = *k * (self.body.point(t, positions) - *d);
            for (&v, b) in self.body.tets[t.tet as usize].iter().zip(t.barycentric) {
                field[v as usize] += pull * b;
            }
        }
    }

    /// Adds −h² aᵀ ∂(∂Ψ_t/∂x)/∂ln E to the clusters' gradients, a the adjoint of the positions.
    pub(crate) fn add_tethers_by_ln_youngs(
        &self,
        adjoint: &[DVec3],
        positions: &[DVec3],
        ends: &[DVec3],
        h2: f64,
        d_ln_youngs: &mut [f64],
    ) {
        for ((t, k), d) in self.body.tethers.iter().zip(&self.tether_stiffness).zip(ends) {
            let work = k * (self.body.point(t, positions) - *d).dot(self.body.point(t, adjoint));
            d_ln_youngs[self.elasticity.cluster[t.tet as usize] as usize] -= h2 * work;
        }
    }
}

/// Ends of tethers must be numbers.
pub(crate) fn check_ends(ends: &[DVec3]) -> Result<(), SimError> {
    check_finite("end of tether", ends)
}

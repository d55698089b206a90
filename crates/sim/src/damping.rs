//! Stiffness-proportional damping in the rotated frame of the step's start.
//!
//! The dissipation potential of a step is β/(2h) (x − xⁿ)ᵀ K(xⁿ) (x − xⁿ) with the linear stiffness of every tet turned by
//! its rotation Rⁿ: with D = F − Fⁿ,
//!     φ = μ‖sym(RⁿᵀD)‖² + (λ/2) tr(RⁿᵀD)²,   P_φ = μ(D + Rⁿ Dᵀ Rⁿ) + λ (Rⁿ : D) Rⁿ.
//! Rayleigh's βK with a K that turns with the body, so that a rotating body at rest shape is not braked to first order.

use crate::body::Batch;
use crate::element::{FreeBlocks, axial};
use crate::models::Model;
use animimic_math::lanes::{Lanes, Mat3x4, Vec3x4, cross, dot, splat};
use animimic_math::polar3::{Polar3x4, polar3};

/// The rotation the damper uses at the step's start; linear elasticity does not turn.
#[inline(always)]
pub(crate) fn frame(model: Model, f_start: &Mat3x4) -> Polar3x4 {
    match model {
        Model::Linear => Polar3x4 { r: Mat3x4::identity(), t: Mat3x4::zero() },
        _ => polar3(f_start),
    }
}

/// φ per unit volume.
pub(crate) fn potential(r: &Mat3x4, d: &Mat3x4, mu: Lanes, lambda: Lanes) -> Lanes {
    let local = r.transpose().matmul(d);
    let strain = local.plus(&local.transpose()).scaled(splat(0.5));
    let trace = strain.trace();
    mu * strain.ddot(&strain) + splat(0.5) * lambda * trace * trace
}

/// P_φ = ∂φ/∂D; linear in D, so also its own differential.
pub(crate) fn stress(r: &Mat3x4, d: &Mat3x4, mu: Lanes, lambda: Lanes) -> Mat3x4 {
    let turned = r.matmul(&d.transpose()).matmul(r);
    d.plus(&turned).scaled(mu).plus(&r.scaled(lambda * r.ddot(d)))
}

/// Adds the blocks V weight [μ(g_a·g_b) I + μ ρ_b ρ_aᵀ + λ ρ_a ρ_bᵀ].
pub(crate) fn add_blocks(batch: &Batch, r: &Mat3x4, mu: Lanes, lambda: Lanes, weight: Lanes, out: &mut FreeBlocks) {
    let w = batch.volume * weight;
    let (mu, lambda) = (mu * w, lambda * w);
    let g = &batch.gradient;
    let rho: [Vec3x4; 3] = std::array::from_fn(|a| r.times(&g[a]));
    for (n, (a, b)) in [(0, 0), (1, 0), (2, 0), (1, 1), (2, 1), (2, 2)].into_iter().enumerate() {
        let diagonal = mu * dot(&g[a], &g[b]);
        for i in 0..3 {
            for j in 0..3 {
                out[n][3 * i + j] += mu * rho[b][i] * rho[a][j] + lambda * rho[a][i] * rho[b][j];
            }
            out[n][4 * i] += diagonal;
        }
    }
}

/// ∂(P_φ : Z)/∂Fⁿ: what P_φ, contracted with Z, owes to the step's start through D = F − Fⁿ and through Rⁿ.
pub(crate) fn start_gradient(frame: &Polar3x4, d: &Mat3x4, z: &Mat3x4, mu: Lanes, lambda: Lanes) -> Mat3x4 {
    let r = &frame.r;
    let rt = r.transpose();
    let q = z.matmul(&rt).matmul(d).plus(&d.matmul(&rt).matmul(z)).scaled(mu);
    let q = q.plus(&d.scaled(lambda * r.ddot(z))).plus(&z.scaled(lambda * r.ddot(d)));
    let omega = frame.t.times(&axial(r, &q));
    let through_rotation = Mat3x4 { cols: std::array::from_fn(|j| cross(&omega, &r.cols[j])) };
    through_rotation.minus(&stress(r, z, mu, lambda))
}

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

/// The damper of four tets in one step; all values are per unit rest volume and divided by h².
pub(crate) struct Damper {
    /// Rⁿ and the operator of its derivative.
    frame: Polar3x4,
    /// D.
    d: Mat3x4,
    /// β/h.
    rate: Lanes,
    /// Lamé parameters times `rate`.
    mu: Lanes,
    lambda: Lanes,
}

impl Damper {
    /// The damper between Fⁿ and F = Fⁿ + D. Linear elasticity does not turn, and neither does its damper.
    pub fn new(model: Model, f_start: &Mat3x4, d: Mat3x4, rate: Lanes, mu: Lanes, lambda: Lanes) -> Self {
        let frame = match model {
            Model::Linear => Polar3x4 { r: Mat3x4::identity(), t: Mat3x4::zero() },
            _ => polar3(f_start),
        };
        Self { frame, d, rate, mu: mu * rate, lambda: lambda * rate }
    }

    /// φ.
    pub fn potential(&self) -> Lanes {
        let local = self.frame.r.transpose().matmul(&self.d);
        let strain = local.plus(&local.transpose()).scaled(splat(0.5));
        let trace = strain.trace();
        self.mu * strain.ddot(&strain) + splat(0.5) * self.lambda * trace * trace
    }

    /// P_φ.
    pub fn stress(&self) -> Mat3x4 {
        self.differential(&self.d)
    }

    /// P_φ with other Lamé parameters: by linearity also its derivative to what they depend on.
    pub fn stress_with(&self, mu: Lanes, lambda: Lanes) -> Mat3x4 {
        linear_stress(&self.frame.r, &self.d, mu * self.rate, lambda * self.rate)
    }

    /// ∂P_φ/∂F : dF; P_φ is linear in D.
    pub fn differential(&self, df: &Mat3x4) -> Mat3x4 {
        linear_stress(&self.frame.r, df, self.mu, self.lambda)
    }

    /// Adds the blocks V weight [μ(g_a·g_b) I + μ ρ_b ρ_aᵀ + λ ρ_a ρ_bᵀ].
    pub fn add_blocks(&self, batch: &Batch, weight: Lanes, out: &mut FreeBlocks) {
        let w = batch.volume * weight;
        let (mu, lambda) = (self.mu * w, self.lambda * w);
        let g = &batch.gradient;
        let rho: [Vec3x4; 3] = std::array::from_fn(|a| self.frame.r.times(&g[a]));
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

    /// ∂P_φ/∂Fⁿ : dFⁿ, through D = F − Fⁿ and through Rⁿ.
    pub fn start_differential(&self, df: &Mat3x4) -> Mat3x4 {
        let (r, d) = (&self.frame.r, &self.d);
        let dr = self.turned(df);
        let turning = dr.matmul(&d.transpose()).matmul(r).plus(&r.matmul(&d.transpose()).matmul(&dr)).scaled(self.mu);
        let turning = turning.plus(&r.scaled(self.lambda * dr.ddot(d))).plus(&dr.scaled(self.lambda * r.ddot(d)));
        turning.minus(&self.differential(df))
    }

    /// ∂(P_φ : Z)/∂Fⁿ, the transpose of [`Damper::start_differential`].
    pub fn start_gradient(&self, z: &Mat3x4) -> Mat3x4 {
        let (r, d) = (&self.frame.r, &self.d);
        let rt = r.transpose();
        let q = z.matmul(&rt).matmul(d).plus(&d.matmul(&rt).matmul(z)).scaled(self.mu);
        let q = q.plus(&d.scaled(self.lambda * r.ddot(z))).plus(&z.scaled(self.lambda * r.ddot(d)));
        self.turned(&q).minus(&self.differential(z))
    }

    /// ∂Rⁿ/∂Fⁿ : A, a symmetric operator.
    fn turned(&self, a: &Mat3x4) -> Mat3x4 {
        let omega = self.frame.t.times(&axial(&self.frame.r, a));
        Mat3x4 { cols: std::array::from_fn(|j| cross(&omega, &self.frame.r.cols[j])) }
    }
}

/// μ(D + R Dᵀ R) + λ (R : D) R.
fn linear_stress(r: &Mat3x4, d: &Mat3x4, mu: Lanes, lambda: Lanes) -> Mat3x4 {
    let turned = r.matmul(&d.transpose()).matmul(r);
    d.plus(&turned).scaled(mu).plus(&r.scaled(lambda * r.ddot(d)))
}

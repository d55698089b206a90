//! Stable neo-Hookean (Smith, de Goes, Kim 2018, eq. 14): ψ = μ̂/2 (I₁ − 3) + λ̂/2 (J − α)² − μ̂/2 ln(I₁ + 1), I₁ = ‖F‖².
//!
//! μ̂ = 4μ/3 and λ̂ = λ + 5μ/6 make its small strains those of linear elasticity with (μ, λ) (their section 3.4), and
//! α = 1 + 3μ̂/(4λ̂) makes rest stress zero. We expand (J − α)² and drop its constant, so that ψ is linear in (μ, λ) and
//! zero at rest: λ̂/2 (J − 1)² − (3/4) μ̂ (J − 1).

use super::{Curvature, Energy, Kinematics, Stress};
use animimic_math::lanes::{Lanes, splat};

pub(crate) struct StableNeoHookean;

#[inline(always)]
fn reparametrised(mu: Lanes, lambda: Lanes) -> (Lanes, Lanes) {
    (splat(4.0 / 3.0) * mu, lambda + splat(5.0 / 6.0) * mu)
}

impl Energy for StableNeoHookean {
    const ROTATES: bool = false;

    #[inline(always)]
    fn energy(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Lanes {
        let (mu, lambda) = reparametrised(mu, lambda);
        let i1 = k.f.ddot(&k.f);
        let volume = k.j - splat(1.0);
        let half = splat(0.5);
        half * mu * (i1 - splat(3.0) - ((i1 + splat(1.0)) * splat(0.25)).ln())
            + volume * (half * lambda * volume - splat(0.75) * mu)
    }

    #[inline(always)]
    fn stress(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Stress {
        let (mu, lambda) = reparametrised(mu, lambda);
        let i1 = k.f.ddot(&k.f);
        Stress {
            f: mu * (splat(1.0) - splat(1.0) / (i1 + splat(1.0))),
            cof: lambda * (k.j - splat(1.0)) - splat(0.75) * mu,
            ..Stress::zero()
        }
    }

    #[inline(always)]
    fn curvature(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Curvature {
        let (mu, lambda) = reparametrised(mu, lambda);
        let i1 = k.f.ddot(&k.f) + splat(1.0);
        Curvature { ff: (mu + mu) / (i1 * i1), cc: lambda, ..Curvature::zero() }
    }
}

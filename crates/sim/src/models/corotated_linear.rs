//! Co-rotated linear elasticity: ψ = μ‖F − R‖² + (λ/2) tr(S − I)², with F = R S. As-rigid-as-possible at λ = 0.
//!
//! P = 2μ(F − R) + λ(tr S − 3) R; d(tr S) = R : dF because R is the maximiser of R : F.

use super::{Curvature, Energy, Kinematics, Stress};
use animimic_math::lanes::{Lanes, splat};

pub(crate) struct CorotatedLinear;

impl Energy for CorotatedLinear {
    const ROTATES: bool = true;

    #[inline(always)]
    fn energy(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Lanes {
        let strain = k.f.minus(&k.r);
        let trace = k.stretch - splat(3.0);
        mu * strain.ddot(&strain) + splat(0.5) * lambda * trace * trace
    }

    #[inline(always)]
    fn stress(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Stress {
        let f = mu + mu;
        Stress { f, r: lambda * (k.stretch - splat(3.0)) - f, ..Stress::zero() }
    }

    #[inline(always)]
    fn curvature(_: &Kinematics, _: Lanes, lambda: Lanes) -> Curvature {
        Curvature { rr: lambda, ..Curvature::zero() }
    }
}

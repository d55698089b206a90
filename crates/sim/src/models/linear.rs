//! Small-strain linear elasticity: ψ = μ‖ε‖² + (λ/2) tr(ε)², ε = (F + Fᵀ)/2 − I.
//!
//! P = μ(F + Fᵀ − 2I) + λ tr(F − I) I: constant Hessian, positive semidefinite for ν < 0.5.

use super::{Curvature, Energy, Kinematics, Stress};
use animimic_math::lanes::{Lanes, Mat3x4, splat};

pub(crate) struct Linear;

impl Energy for Linear {
    const ROTATES: bool = false;

    #[inline(always)]
    fn energy(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Lanes {
        let strain = k.f.plus(&k.f.transpose()).scaled(splat(0.5)).minus(&Mat3x4::identity());
        let trace = strain.trace();
        mu * strain.ddot(&strain) + splat(0.5) * lambda * trace * trace
    }

    #[inline(always)]
    fn stress(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Stress {
        Stress { f: mu, ft: mu, id: lambda * (k.f.trace() - splat(3.0)) - (mu + mu), ..Stress::zero() }
    }

    #[inline(always)]
    fn curvature(_: &Kinematics, _: Lanes, lambda: Lanes) -> Curvature {
        Curvature { ii: lambda, ..Curvature::zero() }
    }
}

//! Fixed corotated (Stomakhin, Howes, Schroeder, Teran 2012): ψ = μ‖F − R‖² + (λ/2)(J − 1)².
//!
//! P = 2μ(F − R) + λ(J − 1) cof F.

use super::{Curvature, Energy, Kinematics, Stress};
use animimic_math::lanes::{Lanes, splat};

pub(crate) struct FixedCorotated;

impl Energy for FixedCorotated {
    const ROTATES: bool = true;

    #[inline(always)]
    fn energy(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Lanes {
        let strain = k.f.minus(&k.r);
        let volume = k.j - splat(1.0);
        mu * strain.ddot(&strain) + splat(0.5) * lambda * volume * volume
    }

    #[inline(always)]
    fn stress(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Stress {
        let f = mu + mu;
        Stress { f, r: -f, cof: lambda * (k.j - splat(1.0)), ..Stress::zero() }
    }

    #[inline(always)]
    fn curvature(_: &Kinematics, _: Lanes, lambda: Lanes) -> Curvature {
        Curvature { cc: lambda, ..Curvature::zero() }
    }
}

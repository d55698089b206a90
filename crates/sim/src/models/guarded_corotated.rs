//! Fixed corotated that stiffens where a tet is squashed: ψ = μ‖F − R‖² + (λ/2)(J − 1)² + κμ max(0, 1 − J/J₀)³.
//!
//! Fixed corotated reaches inversion at a finite, low force; flesh between two bones of a bent limb is pushed harder than
//! that. The added cubic is zero above J₀, twice differentiable at it, and finite below zero, so a step that begins inverted
//! still finds out (unlike a logarithm). P gets −(3κμ/J₀) g² cof F, g = max(0, 1 − J/J₀).

use super::{Curvature, Energy, FixedCorotated, Kinematics, Stress};
use animimic_math::lanes::{Lanes, splat};

pub(crate) struct GuardedCorotated;

/// κ: at J = 0 the guard pushes back 30 times as hard as fixed corotated at ν = 0.4.
const KAPPA: f64 = 16.0;
/// J₀: the share of its volume below which a tet stiffens.
const FROM: f64 = 0.4;

fn depth(k: &Kinematics) -> Lanes {
    (splat(1.0) - k.j * splat(1.0 / FROM)).max(splat(0.0))
}

impl Energy for GuardedCorotated {
    const ROTATES: bool = true;

    #[inline(always)]
    fn energy(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Lanes {
        let g = depth(k);
        FixedCorotated::energy(k, mu, lambda) + splat(KAPPA) * mu * g * g * g
    }

    #[inline(always)]
    fn stress(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Stress {
        let g = depth(k);
        let s = FixedCorotated::stress(k, mu, lambda);
        Stress { cof: s.cof - splat(3.0 * KAPPA / FROM) * mu * g * g, ..s }
    }

    #[inline(always)]
    fn curvature(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Curvature {
        let c = FixedCorotated::curvature(k, mu, lambda);
        Curvature { cc: c.cc + splat(6.0 * KAPPA / (FROM * FROM)) * mu * depth(k), ..c }
    }
}

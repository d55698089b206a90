//! Constitutive models: a family. A member is one file and one word in [`Model::ALL`].
//!
//! Every isotropic energy here has a first Piola–Kirchhoff stress of the form
//!     P = a F + b R + c cof F + d Fᵀ + e I
//! with scalar coefficients of the invariants, so its Hessian is, by the product rule,
//!     ∂P/∂F = a I + b ∂R + c ∂cof + d (·)ᵀ + h_F F⊗F + h_R R⊗R + h_C cof⊗cof + h_I I⊗I.
//! A member only gives ψ, the coefficients and the h's; the tensors are assembled once, in `element.rs`. All members are
//! linear in the Lamé parameters, so ∂P/∂E and ∂P/∂ν are P itself with (μ, λ) replaced by their derivatives.

mod corotated_linear;
mod fixed_corotated;
mod guarded_corotated;
mod linear;
mod stable_neo_hookean;

pub(crate) use corotated_linear::CorotatedLinear;
pub(crate) use fixed_corotated::FixedCorotated;
pub(crate) use guarded_corotated::GuardedCorotated;
pub(crate) use linear::Linear;
pub(crate) use stable_neo_hookean::StableNeoHookean;

use animimic_math::lanes::{Lanes, Mat3x4, splat};

/// Which hyperelastic energy a body has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// Stomakhin et al. 2012; the default.
    #[default]
    FixedCorotated,
    /// Smith, de Goes, Kim 2018.
    StableNeoHookean,
    /// Small-strain linear elasticity; not invariant under rotation.
    Linear,
    /// Co-rotated linear elasticity; as-rigid-as-possible at λ = 0.
    CorotatedLinear,
    /// Fixed corotated that stiffens below 40 % of a tet's volume.
    GuardedCorotated,
}

impl Model {
    /// Every member, in the order of lists and help texts.
    pub const ALL: [Model; 5] = [
        Model::FixedCorotated,
        Model::StableNeoHookean,
        Model::Linear,
        Model::CorotatedLinear,
        Model::GuardedCorotated,
    ];

    /// The word for it in options and lists.
    pub fn name(self) -> &'static str {
        match self {
            Model::FixedCorotated => "fixed-corotated",
            Model::StableNeoHookean => "stable-neo-hookean",
            Model::Linear => "linear",
            Model::CorotatedLinear => "corotated-linear",
            Model::GuardedCorotated => "guarded-corotated",
        }
    }

    /// One line for lists.
    pub fn about(self) -> &'static str {
        match self {
            Model::FixedCorotated => "μ‖F−R‖² + λ/2 (det F − 1)²: stiff against inversion, the default",
            Model::StableNeoHookean => "rubber-like, smooth everywhere, no rotation to find (Smith et al. 2018)",
            Model::Linear => "small strain only; exact and quadratic, wrong under rotation",
            Model::GuardedCorotated => {
                "fixed-corotated that stiffens below 40 % of its volume: for flesh between bones"
            }
            Model::CorotatedLinear => "linear elasticity in the rotated frame; as-rigid-as-possible at ν = 0",
        }
    }

    /// The member with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|m| m.name() == name)
    }
}

/// What a model may look at: the deformation gradient and what is derived from it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kinematics {
    /// Deformation gradient F.
    pub f: Mat3x4,
    /// cof F.
    pub cof: Mat3x4,
    /// det F.
    pub j: Lanes,
    /// Polar rotation R (zero if the model has no use for it).
    pub r: Mat3x4,
    /// (tr(S) I − F Rᵀ)⁻¹, the operator of ∂R.
    pub t: Mat3x4,
    /// tr S = R : F.
    pub stretch: Lanes,
}

/// Coefficients a..e of P, see the module documentation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stress {
    pub f: Lanes,
    pub r: Lanes,
    pub cof: Lanes,
    pub ft: Lanes,
    pub id: Lanes,
}

impl Stress {
    pub fn zero() -> Self {
        let o = splat(0.0);
        Self { f: o, r: o, cof: o, ft: o, id: o }
    }
}

/// Coefficients h_F, h_R, h_C, h_I of ∂P/∂F.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Curvature {
    pub ff: Lanes,
    pub rr: Lanes,
    pub cc: Lanes,
    pub ii: Lanes,
}

impl Curvature {
    pub fn zero() -> Self {
        let o = splat(0.0);
        Self { ff: o, rr: o, cc: o, ii: o }
    }
}

/// One constitutive model, per unit rest volume.
pub(crate) trait Energy {
    /// Whether R and T are needed.
    const ROTATES: bool;
    /// ψ(F), zero at rest.
    fn energy(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Lanes;
    /// Coefficients of P = ∂ψ/∂F.
    fn stress(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Stress;
    /// Coefficients of the outer products in ∂P/∂F.
    fn curvature(k: &Kinematics, mu: Lanes, lambda: Lanes) -> Curvature;
}

/// Calls `$call` with the type `M` bound to the model's member.
macro_rules! with_model {
    ($model:expr, $M:ident => $call:expr) => {
        match $model {
            $crate::models::Model::FixedCorotated => {
                type $M = $crate::models::FixedCorotated;
                $call
            }
            $crate::models::Model::StableNeoHookean => {
                type $M = $crate::models::StableNeoHookean;
                $call
            }
            $crate::models::Model::Linear => {
                type $M = $crate::models::Linear;
                $call
            }
            $crate::models::Model::CorotatedLinear => {
                type $M = $crate::models::CorotatedLinear;
                $call
            }
            $crate::models::Model::GuardedCorotated => {
                type $M = $crate::models::GuardedCorotated;
                $call
            }
        }
    };
}
pub(crate) use with_model;

#[cfg(test)]
mod tests;

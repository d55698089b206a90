//! What is known of joints without looking: they rest near a reference rotation, bend within limits, hinge about an axis.
//!
//! E_j = k |log(R̄ᵀR)|² + k_lim max(|log R| − limit, 0)² + k_slide |t − t̄|² + per-axis stiffness on log(R̄ᵀR).

use super::{At, Context, Term};
use crate::normal::NormalEquations;
use animimic_math::so3;
use glam::{DMat3, DVec3};

/// Priors of one joint in one frame.
#[derive(Clone, Copy, Debug)]
pub struct JointPrior {
    /// Reference rotation R̄.
    pub rotation: DMat3,
    /// Stiffness towards R̄ [1/rad²].
    pub stiffness: f64,
    /// Further stiffness of log(R̄ᵀR) along two axes (joint space at R̄), an axis' length being the square root of it.
    pub stiff_axes: [DVec3; 2],
    /// Angle from rest beyond which the limit acts [rad].
    pub limit_rad: f64,
    /// Stiffness of the limit [1/rad²].
    pub limit_stiffness: f64,
    /// Reference displacement t̄ [model unit].
    pub displacement: DVec3,
    /// Stiffness towards t̄ [1/model unit²].
    pub slide_stiffness: f64,
    /// Further stiffness of t − t̄ along an axis, the axis' length being the square root of it.
    pub slide_axis: DVec3,
}

impl JointPrior {
    /// No prior at all.
    pub const FREE: Self = Self {
        rotation: DMat3::IDENTITY,
        stiffness: 0.0,
        stiff_axes: [DVec3::ZERO; 2],
        limit_rad: f64::INFINITY,
        limit_stiffness: 0.0,
        displacement: DVec3::ZERO,
        slide_stiffness: 0.0,
        slide_axis: DVec3::ZERO,
    };
}

/// Priors of all joints.
#[derive(Clone, Debug)]
pub struct JointPriors {
    /// \[frame\]\[joint\]; the last entry serves all later frames too.
    pub joints: Vec<Vec<JointPrior>>,
}

impl JointPriors {
    fn of(&self, frame: usize) -> &[JointPrior] {
        &self.joints[frame.min(self.joints.len() - 1)]
    }
}

impl Term for JointPriors {
    fn name(&self) -> &'static str {
        "joint_prior"
    }

    fn energy(&self, context: &Context, at: &At) -> f64 {
        let mut sum = 0.0;
        for (j, prior) in self.of(at.frame).iter().enumerate() {
            if context.kinematics.turns[j] {
                let w = so3::log(&(prior.rotation.transpose() * at.pose.rotations[j]));
                let beyond = (so3::log(&at.pose.rotations[j]).length() - prior.limit_rad).max(0.0);
                sum += prior.stiffness * w.length_squared()
                    + prior.stiff_axes.iter().map(|a| a.dot(w).powi(2)).sum::<f64>()
                    + prior.limit_stiffness * beyond * beyond;
            }
            if context.kinematics.slides[j] {
                let d = at.pose.displacements[j] - prior.displacement;
                sum += prior.slide_stiffness * d.length_squared() + prior.slide_axis.dot(d).powi(2);
            }
        }
        sum
    }

    fn linearize(&self, context: &Context, at: &At, normal: &mut NormalEquations) {
        for (j, prior) in self.of(at.frame).iter().enumerate() {
            if let Some(o) = context.kinematics.turn_offset[j] {
                let r = at.pose.rotations[j];
                let w = so3::log(&(prior.rotation.transpose() * r));
                // d log(R̄ᵀR exp δ) = J_r⁻¹(w) δ; J_r⁻ᵀ w = w keeps the isotropic part's gradient simple.
                for k in 0..3 {
                    normal.add_row(&[(o + k, 1.0)], w[k], prior.stiffness);
                }
                for axis in prior.stiff_axes.into_iter().filter(|a| *a != DVec3::ZERO) {
                    let g = so3::right_jacobian_inverse(w).transpose() * axis;
                    normal.add_row(&[(o, g.x), (o + 1, g.y), (o + 2, g.z)], axis.dot(w), 1.0);
                }
                let from_rest = so3::log(&r);
                let angle = from_rest.length();
                if angle > prior.limit_rad && prior.limit_stiffness > 0.0 {
                    let u = from_rest / angle;
                    let row = [(o, u.x), (o + 1, u.y), (o + 2, u.z)];
                    normal.add_row(&row, angle - prior.limit_rad, prior.limit_stiffness);
                }
            }
            if let Some(o) = context.kinematics.slide_offset[j] {
                let d = at.pose.displacements[j] - prior.displacement;
                for k in 0..3 {
                    normal.add_row(&[(o + k, 1.0)], d[k], prior.slide_stiffness);
                }
                let a = prior.slide_axis;
                normal.add_row(&[(o, a.x), (o + 1, a.y), (o + 2, a.z)], a.dot(d), 1.0);
            }
        }
    }
}

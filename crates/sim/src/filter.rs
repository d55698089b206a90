//! Element Hessians made positive semidefinite by filtering their eigenvalues.
//!
//! With the rotation-variant SVD F = U Σ Vᵀ the 9×9 Hessian splits (Smith, de Goes, Kim 2019, "Analytic eigensystems for
//! isotropic distortion energies") into three twists with eigenvalue a + 2b/(σᵢ+σⱼ) + c σₖ, three flips a − c σₖ, and a 3×3
//! block of stretches A_ii = a + h_F σᵢ² + h_R + h_C cᵢ², A_ij = c σₖ + h_F σᵢσⱼ + h_R + h_C cᵢcⱼ with cᵢ = σⱼσₖ.
//! Teran et al. 2005 clamp negative eigenvalues at zero; Chen et al. 2024 take absolute values.

use crate::body::Batch;
use crate::element::FreeBlocks;
use crate::models::{Curvature, Kinematics, Stress};
use animimic_math::lanes::{Lanes, Mat3x4, Vec3x4, splat};
use animimic_math::polar3::SMALLEST_SUM;
use animimic_math::svd3::svd3;

/// What is done with negative eigenvalues of element Hessians in the Newton step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// Nothing: the step fails, and says so, where the Hessian is not positive definite.
    None,
    /// Set to zero in every element and iteration.
    Clamp,
    /// Replaced by their absolute values in every element and iteration.
    Absolute,
    /// The true Hessian while it is positive definite, else shifted by a multiple of the mass, clamped as a last resort.
    #[default]
    OnDemand,
}

/// How one element Hessian is filtered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Eigenvalues {
    True,
    Clamped,
    Absolute,
}

impl Eigenvalues {
    #[inline(always)]
    fn apply(self, v: Lanes) -> Lanes {
        match self {
            Eigenvalues::True => v,
            Eigenvalues::Clamped => v.max(splat(0.0)),
            Eigenvalues::Absolute => v.abs(),
        }
    }

    /// The filtered symmetric matrix: |A| = V |Σ| Vᵀ from its SVD, and (A + |A|)/2.
    fn apply_symmetric(self, a: &Mat3x4) -> Mat3x4 {
        if self == Eigenvalues::True {
            return *a;
        }
        let s = svd3(a);
        let scaled = Mat3x4 { cols: std::array::from_fn(|j| s.v.cols[j].map(|v| v * s.sigma[j].abs())) };
        let absolute = scaled.matmul_transpose(&s.v);
        if self == Eigenvalues::Absolute { absolute } else { absolute.plus(a).scaled(splat(0.5)) }
    }
}

/// Blocks of the filtered Hessian of an isotropic model (d = h_I = 0), times `weight`.
pub(crate) fn filtered_blocks(
    batch: &Batch,
    k: &Kinematics,
    s: &Stress,
    h: &Curvature,
    weight: Lanes,
    filter: Eigenvalues,
) -> FreeBlocks {
    let svd = svd3(&k.f);
    let sigma = svd.sigma;
    let c: Vec3x4 = [sigma[1] * sigma[2], sigma[0] * sigma[2], sigma[0] * sigma[1]];
    // Half sum and half difference of flip and twist of the pair other than k.
    let (mut mean, mut half) = ([splat(0.0); 3], [splat(0.0); 3]);
    let mut a = Mat3x4::zero();
    for k in 0..3 {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let sum = (sigma[i] + sigma[j]).max(splat(SMALLEST_SUM));
        let twist = filter.apply(s.f + (s.r + s.r) / sum + s.cof * sigma[k]);
        let flip = filter.apply(s.f - s.cof * sigma[k]);
        (mean[k], half[k]) = ((flip + twist) * splat(0.5), (flip - twist) * splat(0.5));
        a.cols[k][k] = s.f + h.ff * sigma[k] * sigma[k] + h.rr + h.cc * c[k] * c[k];
        let off = s.cof * sigma[k] + h.ff * sigma[i] * sigma[j] + h.rr + h.cc * c[i] * c[j];
        (a.cols[i][j], a.cols[j][i]) = (off, off);
    }
    let a = filter.apply_symmetric(&a);
    let g: [Vec3x4; 3] = std::array::from_fn(|n| svd.v.transpose_times(&batch.gradient[n]));
    let w = batch.volume * weight;
    [(0, 0), (1, 0), (2, 0), (1, 1), (2, 1), (2, 2)].map(|(p, q): (usize, usize)| {
        let (ga, gb) = (&g[p], &g[q]);
        let mut m = Mat3x4::zero();
        for i in 0..3 {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            m.cols[i][i] = a.at(i, i) * ga[i] * gb[i] + mean[k] * ga[j] * gb[j] + mean[j] * ga[k] * gb[k];
            m.cols[j][i] = a.at(i, j) * ga[i] * gb[j] + half[k] * ga[j] * gb[i];
            m.cols[i][j] = a.at(j, i) * ga[j] * gb[i] + half[k] * ga[i] * gb[j];
        }
        let block = svd.u.matmul(&m).matmul_transpose(&svd.u);
        std::array::from_fn(|e| block.at(e / 3, e % 3) * w)
    })
}

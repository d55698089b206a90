//! The rotation nearest to a 3×3 matrix and its derivative, four at a time.
//!
//! R = argmin over rotations of ‖F − R‖², the polar factor of F = R S with det R = +1 (so that S has a negative
//! eigenvalue when det F < 0). With σ the rotation-variant singular values, x = tr S = σ₀+σ₁+σ₂ is the largest root of
//!     p(x) = x⁴ − 2 I₁ x² − 8 J x + 2 I₂ − I₁²,    I₁ = ‖F‖²,  I₂ = ‖FᵀF‖²,  J = det F,
//! and R = ∂x/∂F follows from p(x; F) = 0 by implicit differentiation (Lin, Cao, Ouyang 2022, "Isotropic ARAP energy
//! using Cauchy–Green invariants"): no iteration over matrix entries. p′(x) = 8 Π(σᵢ+σⱼ) measures the conditioning; where it is small the SVD takes over.
//!
//! Derivative: for dF, dR = R [ω]× with (tr(S) I − S) ω = axial(RᵀdF − dFᵀR). In the frame of the world
//!     dF = u gᵀ  ⇒  dR = [T (Rg × u)]× R,    T = (tr(S) I − F Rᵀ)⁻¹,
//! so only the sums σᵢ+σⱼ appear and no singular vector is ever differentiated.

use crate::lanes::{Lanes, Mat3x4, dot, scale, splat};
use crate::svd3::svd3;

/// Newton steps of the quartic; from the upper bound √(3 I₁) it needs 3 to 6 when well conditioned.
const MAX_NEWTON: usize = 16;
/// The quartic is used where p′(x) exceeds this share of x³; the error of R is then about 1e-16 / share².
const WELL_CONDITIONED: f64 = 0.2;
/// Smallest σᵢ+σⱼ in the derivative: R jumps where the sum changes sign, and 1/(σᵢ+σⱼ) is cut there.
pub const SMALLEST_SUM: f64 = 1e-6;

/// Rotation and the operator of its derivative.
#[derive(Clone, Copy, Debug)]
pub struct Polar3x4 {
    /// The polar rotation R.
    pub r: Mat3x4,
    /// T = (tr(S) I − F Rᵀ)⁻¹, symmetric; its eigenvalues are 1/(σᵢ+σⱼ).
    pub t: Mat3x4,
}

/// Rotation part and derivative operator of four matrices; R = I at F = 0.
#[inline(always)]
pub fn polar3(f: &Mat3x4) -> Polar3x4 {
    match by_quartic(f) {
        Some(polar) => polar,
        None => by_svd(f),
    }
}

#[inline(always)]
fn by_quartic(f: &Mat3x4) -> Option<Polar3x4> {
    let c = f.transpose().matmul(f);
    let (i1, i2, cof) = (c.trace(), c.ddot(&c), f.cofactor());
    let j = dot(&f.cols[0], &cof.cols[0]);
    let constant = i2 + i2 - i1 * i1;
    let mut x = (i1 * splat(3.0)).sqrt();
    let derivative = |x: Lanes| splat(4.0) * (x * (x * x - i1) - (j + j));
    for _ in 0..MAX_NEWTON {
        let x2 = x * x;
        let p = x2.mul_add(x2 - (i1 + i1), (constant) - splat(8.0) * j * x);
        let dx = p / derivative(x);
        x -= dx;
        if !dx.abs().simd_gt(splat(4e-16) * x.abs()).any() {
            break;
        }
    }
    let slope = derivative(x);
    if !slope.simd_ge(splat(WELL_CONDITIONED) * x * x * x).all() || !x.simd_gt(splat(0.0)).all() {
        return None;
    }
    // R = (4(x² + I₁) F + 8x cof F − 8 F FᵀF) / p′
    let ffc = f.matmul(&c);
    let (a, b, d) = (splat(4.0) * (x * x + i1) / slope, splat(8.0) * x / slope, splat(8.0) / slope);
    let r = f.scaled(a).plus(&cof.scaled(b)).minus(&ffc.scaled(d));
    let mut k = f.matmul_transpose(&r).scaled(splat(-1.0));
    (0..3).for_each(|i| k.cols[i][i] += x);
    let half = splat(0.5);
    let k = k.plus(&k.transpose()).scaled(half);
    let inverse = k.cofactor();
    let det = dot(&k.cols[0], &inverse.cols[0]);
    Some(Polar3x4 { r, t: inverse.scaled(splat(1.0) / det) })
}

#[cold]
#[inline(never)]
fn by_svd(f: &Mat3x4) -> Polar3x4 {
    let s = svd3(f);
    let r = s.u.matmul_transpose(&s.v);
    let weight = |i: usize, j: usize| splat(1.0) / (s.sigma[i] + s.sigma[j]).max(splat(SMALLEST_SUM));
    let w = [weight(1, 2), weight(0, 2), weight(0, 1)];
    let scaled = Mat3x4 { cols: std::array::from_fn(|k| scale(&s.u.cols[k], w[k])) };
    Polar3x4 { r, t: scaled.matmul_transpose(&s.u) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradcheck::SplitMix64;
    use crate::lanes::{add, cross};

    fn largest_difference(a: &Mat3x4, b: &Mat3x4) -> f64 {
        a.minus(b).cols.iter().flatten().flat_map(|v| v.abs().to_array()).fold(0.0, f64::max)
    }

    fn random(rng: &mut SplitMix64, spread: f64) -> Mat3x4 {
        let entry = |i: usize, j: usize, n: f64| f64::from(u8::from(i == j)) + spread * n;
        Mat3x4::from_rows(std::array::from_fn(|_| {
            std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j, rng.normal())))
        }))
    }

    #[test]
    fn the_quartic_and_the_svd_give_the_same_rotation_and_derivative() {
        let mut rng = SplitMix64(7);
        let (mut worst, mut taken) = (0.0f64, 0);
        for n in 0..4000 {
            let f = random(&mut rng, [1e-9, 0.1, 0.5, 2.0][n % 4]);
            let (Some(a), b) = (by_quartic(&f), by_svd(&f)) else { continue };
            taken += 1;
            worst = worst.max(largest_difference(&a.r, &b.r)).max(largest_difference(&a.t, &b.t) * 0.1);
        }
        println!("quartic against SVD: {worst:.2e} over {taken} batches");
        assert!(worst < 1e-12 && taken > 2000);
    }

    #[test]
    fn degenerate_matrices_have_a_finite_rotation() {
        let z = [[0.0; 3]; 3];
        let plane = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]];
        let minus = [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]];
        let line = [[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [-1.0, -2.0, -3.0]];
        let p = polar3(&Mat3x4::from_rows([z, plane, minus, line]));
        assert!(p.r.cols.iter().chain(&p.t.cols).flatten().all(|v| v.is_finite().all()));
        assert_eq!(p.r.lane(0), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        assert!(p.r.determinant().to_array().iter().all(|d| (d - 1.0).abs() < 1e-14));
    }

    #[test]
    fn the_derivative_of_the_rotation_is_the_limit_of_differences() {
        let mut rng = SplitMix64(9);
        let mut worst = 0.0f64;
        for _ in 0..300 {
            let f = random(&mut rng, 0.4);
            let p = polar3(&f);
            if p.t.trace().to_array().iter().any(|t| *t > 8.0) {
                continue; // a pair with σ_i+σ_j near zero: finite differences lose their digits there
            }
            let u = [0, 1, 2].map(|_| splat(rng.normal()));
            let g = [0, 1, 2].map(|_| splat(rng.normal()));
            let omega = p.t.times(&cross(&p.r.times(&g), &u));
            let analytic = Mat3x4 { cols: std::array::from_fn(|j| cross(&omega, &p.r.cols[j])) };
            let eps = 1e-5;
            let moved = |s: f64| Mat3x4 { cols: std::array::from_fn(|j| add(&f.cols[j], &scale(&u, g[j] * splat(s)))) };
            let numeric = polar3(&moved(eps)).r.minus(&polar3(&moved(-eps)).r).scaled(splat(0.5 / eps));
            let size = analytic.cols.iter().flatten().flat_map(|v| v.abs().to_array()).fold(1e-3, f64::max);
            worst = worst.max(largest_difference(&analytic, &numeric) / size);
        }
        println!("dR against central differences: {worst:.2e}");
        assert!(worst < 1e-6);
    }
}

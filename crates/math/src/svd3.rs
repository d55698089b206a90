//! Rotation-variant singular value decomposition of 3×3 matrices, four at a time.
//!
//! F = U diag(σ) Vᵀ with det U = det V = +1 and σ₀ ≥ σ₁ ≥ |σ₂|: the smallest singular value carries the sign of det F
//! (Irving, Teran, Fedkiw 2004). One-sided Jacobi (Hestenes 1958): rotations V make the columns of F V orthogonal, which
//! keeps small singular values to full relative accuracy, unlike the eigenvectors of FᵀF. Nothing here is ever
//! differentiated: derivatives of what is built from it have their own closed forms.

use crate::lanes::{Lanes, Mat3x4, Vec3x4, cross, dot, scale, splat};

/// Sweeps after which 3×3 one-sided Jacobi has long converged (it takes 4 to 6 from any start).
const MAX_SWEEPS: usize = 12;
/// Columns count as orthogonal when |b_p · b_q| ≤ this × |b_p| |b_q|: two units in the last place.
const ORTHOGONAL: f64 = 4.5e-16;
/// Ratio σ₁/σ₀ under which the second left vector is noise and is chosen freely.
const COLLAPSED: f64 = 1e-290;

/// U, σ and V of four matrices.
#[derive(Clone, Copy, Debug)]
pub struct Svd3x4 {
    /// Left vectors, a rotation.
    pub u: Mat3x4,
    /// Singular values, descending in magnitude, the last one signed.
    pub sigma: Vec3x4,
    /// Right vectors, a rotation.
    pub v: Mat3x4,
}

/// Decomposes four matrices; any finite input, F = 0 included (U = V = I there).
pub fn svd3(f: &Mat3x4) -> Svd3x4 {
    // Scaling by the largest entry keeps squares inside the range of f64.
    let largest = f.cols.iter().flatten().fold(splat(0.0), |m, e| m.max(e.abs()));
    let zero = !largest.simd_gt(splat(0.0));
    let size = zero.bitselect(splat(1.0), largest);
    let mut b = f.scaled(splat(1.0) / size);
    let mut v = Mat3x4::identity();
    for _ in 0..MAX_SWEEPS {
        let mut moved = splat(0.0);
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            moved |= rotate(&mut b, &mut v, p, q);
        }
        if !moved.any() {
            break;
        }
    }
    for (p, q) in [(0, 1), (0, 2), (1, 2)] {
        sort(&mut b, &mut v, p, q);
    }
    let (u, sigma) = left_vectors(&b);
    let identity = Mat3x4::identity();
    Svd3x4 {
        u: Mat3x4::select(zero, &identity, &u),
        sigma: scale(&sigma, zero.bitselect(splat(0.0), size)),
        v: Mat3x4::select(zero, &identity, &v),
    }
}

/// One Jacobi rotation of columns p, q; returns the mask of lanes that were not yet orthogonal.
#[inline(always)]
fn rotate(b: &mut Mat3x4, v: &mut Mat3x4, p: usize, q: usize) -> Lanes {
    let (alpha, beta) = (dot(&b.cols[p], &b.cols[p]), dot(&b.cols[q], &b.cols[q]));
    let gamma = dot(&b.cols[p], &b.cols[q]);
    let moved = gamma.abs().simd_gt(splat(ORTHOGONAL) * (alpha * beta).sqrt());
    // tan of the rotation angle, the smaller root of t² + 2ζt − 1 = 0, written without dividing by γ.
    let d = beta - alpha;
    let twice = gamma + gamma;
    let denominator = d.abs() + d.mul_add(d, twice * twice).sqrt();
    let sign = d.simd_lt(splat(0.0)).bitselect(splat(-1.0), splat(1.0));
    let t = moved.bitselect(sign * twice / denominator, splat(0.0));
    let c = splat(1.0) / t.mul_add(t, splat(1.0)).sqrt();
    let s = c * t;
    for m in [b, v] {
        let (x, y) = (m.cols[p], m.cols[q]);
        m.cols[p] = std::array::from_fn(|i| c.mul_sub(x[i], s * y[i]));
        m.cols[q] = std::array::from_fn(|i| s.mul_add(x[i], c * y[i]));
    }
    moved
}

/// Swaps columns p < q where the later one is longer; one of them changes sign so that det V stays +1.
#[inline(always)]
fn sort(b: &mut Mat3x4, v: &mut Mat3x4, p: usize, q: usize) {
    let swap = dot(&b.cols[q], &b.cols[q]).simd_gt(dot(&b.cols[p], &b.cols[p]));
    for m in [b, v] {
        let (x, y) = (m.cols[p], m.cols[q]);
        m.cols[p] = std::array::from_fn(|i| swap.bitselect(y[i], x[i]));
        m.cols[q] = std::array::from_fn(|i| swap.bitselect(-x[i], y[i]));
    }
}

/// Normalised columns of B = U diag(σ), completed to a rotation where B is rank deficient.
#[inline(always)]
fn left_vectors(b: &Mat3x4) -> (Mat3x4, Vec3x4) {
    let one = splat(1.0);
    let s0 = dot(&b.cols[0], &b.cols[0]).sqrt();
    let u0 = scale(&b.cols[0], one / s0.max(splat(f64::MIN_POSITIVE)));
    let raw1 = b.cols[1];
    // Taking the residue of u0 out again costs nothing and makes U orthogonal to the last bit.
    let along = dot(&u0, &raw1);
    let clean1: Vec3x4 = std::array::from_fn(|i| raw1[i] - along * u0[i]);
    let s1 = dot(&clean1, &clean1).sqrt();
    let collapsed = !s1.simd_gt(splat(COLLAPSED) * s0);
    let free = perpendicular(&u0);
    let inverse = one / collapsed.bitselect(one, s1);
    let u1: Vec3x4 = std::array::from_fn(|i| collapsed.bitselect(free[i], clean1[i] * inverse));
    let u2 = cross(&u0, &u1);
    (Mat3x4 { cols: [u0, u1, u2] }, [s0, s1, dot(&u2, &b.cols[2])])
}

/// A unit vector perpendicular to a unit vector (Duff et al. 2017).
#[inline(always)]
fn perpendicular(n: &Vec3x4) -> Vec3x4 {
    let sign = n[2].simd_lt(splat(0.0)).bitselect(splat(-1.0), splat(1.0));
    let a = splat(-1.0) / (sign + n[2]);
    let b = n[0] * n[1] * a;
    [sign.mul_add(n[0] * n[0] * a, splat(1.0)), sign * b, -(sign * n[0])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradcheck::SplitMix64;

    fn random(rng: &mut SplitMix64) -> [[f64; 3]; 3] {
        std::array::from_fn(|_| std::array::from_fn(|_| rng.normal()))
    }

    fn worst_defect(m: [[[f64; 3]; 3]; 4]) -> f64 {
        let f = Mat3x4::from_rows(m);
        let s = svd3(&f);
        let mut sigma = Mat3x4::zero();
        (0..3).for_each(|i| sigma.cols[i][i] = s.sigma[i]);
        let rebuilt = s.u.matmul(&sigma).matmul_transpose(&s.v);
        let mut worst = 0.0f64;
        for lane in 0..4 {
            let size = m[lane].iter().flatten().fold(1e-300f64, |a, b| a.max(b.abs()));
            let [u, v, r] = [s.u.lane(lane), s.v.lane(lane), rebuilt.lane(lane)];
            for i in 0..3 {
                for j in 0..3 {
                    worst = worst.max((r[i][j] - m[lane][i][j]).abs() / size);
                    for q in [&u, &v] {
                        let d: f64 = (0..3).map(|k| q[k][i] * q[k][j]).sum();
                        worst = worst.max((d - f64::from(u8::from(i == j))).abs());
                    }
                }
            }
            for q in [&s.u, &s.v] {
                worst = worst.max((q.determinant().to_array()[lane] - 1.0).abs());
            }
            let sig: Vec<f64> = s.sigma.iter().map(|x| x.to_array()[lane]).collect();
            assert!(sig[0] >= sig[1] && sig[1] >= sig[2].abs() * (1.0 - 1e-14), "order {sig:?}");
        }
        worst
    }

    #[test]
    fn random_matrices_are_rebuilt_by_two_rotations() {
        let mut rng = SplitMix64(3);
        let worst = (0..2000).map(|_| worst_defect(std::array::from_fn(|_| random(&mut rng)))).fold(0.0, f64::max);
        println!("worst defect of 8000 random matrices: {worst:.2e}");
        assert!(worst < 1e-14);
    }

    #[test]
    fn flat_collapsed_inverted_repeated_and_huge_matrices_are_regular() {
        let i3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let z = [[0.0; 3]; 3];
        let plane = [[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [0.5, -1.0, 2.0]];
        let line = [[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [-1.0, -2.0, -3.0]];
        let tiny = plane.map(|r| r.map(|v| v * 1e-200));
        let huge = plane.map(|r| r.map(|v| v * 1e200));
        let mirrored = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let graded = [[1.0, 1e-9, 0.0], [0.0, 1e-12, 1e-15], [0.0, 0.0, 1e-18]];
        let worst = worst_defect([i3, z, plane, line]).max(worst_defect([tiny, huge, mirrored, graded]));
        println!("worst defect: {worst:.2e}");
        assert!(worst < 1e-14);
    }

    #[test]
    fn the_last_singular_value_carries_the_sign_of_the_determinant() {
        let mut rng = SplitMix64(5);
        for _ in 0..200 {
            let f = Mat3x4::from_rows(std::array::from_fn(|_| random(&mut rng)));
            let s = svd3(&f);
            let product = s.sigma[0] * s.sigma[1] * s.sigma[2];
            let error = (product - f.determinant()).abs().to_array();
            assert!(error.iter().all(|e| *e < 1e-13), "{error:?}");
        }
    }
}

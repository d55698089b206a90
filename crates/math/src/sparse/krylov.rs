//! Iterative solves preconditioned by a neighbouring matrix's Cholesky factor.
//!
//! Conjugate gradients (Hestenes & Stiefel 1952) where the matrix is positive definite; MINRES (Paige & Saunders 1975)
//! where it is not. With the factor of a nearby matrix both need a handful of iterations.

use super::block_matrix::BlockMatrix;
use super::cholesky::Factor;
use super::symbolic::Symbolic;

/// How an iterative solve ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ended {
    /// The residual is below the tolerance.
    Converged {
        /// Matrix products used.
        iterations: usize,
    },
    /// A direction p with pᵀAp ≤ 0 was met: the matrix is not positive definite.
    NegativeCurvature,
    /// The limit of iterations was reached.
    TooSlow,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// y += s x.
fn axpy(s: f64, x: &[f64], y: &mut [f64]) {
    x.iter().zip(y).for_each(|(x, y)| *y += s * x);
}

/// Preconditioned conjugate gradients for A x = b from x = 0, until the energy norm of the error, estimated by
/// √(rᵀP⁻¹r / bᵀP⁻¹b), is below `tolerance`.
pub fn conjugate_gradients(
    symbolic: &Symbolic,
    factor: &Factor,
    matrix: &BlockMatrix,
    b: &[f64],
    tolerance: f64,
    limit: usize,
) -> (Vec<f64>, Ended) {
    let mut x = vec![0.0; b.len()];
    let mut r = b.to_vec();
    let mut z = r.clone();
    factor.solve(symbolic, &mut z);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let target = rz * tolerance * tolerance;
    let mut ap = vec![0.0; b.len()];
    for iteration in 0..=limit {
        if rz <= target {
            return (x, Ended::Converged { iterations: iteration });
        }
        matrix.times_in_parts(symbolic, &p, &mut ap);
        let curvature = dot(&p, &ap);
        // A NaN must end the solve too.
        if curvature <= 0.0 || curvature.is_nan() {
            return (x, Ended::NegativeCurvature);
        }
        let alpha = rz / curvature;
        axpy(alpha, &p, &mut x);
        axpy(-alpha, &ap, &mut r);
        z.copy_from_slice(&r);
        factor.solve(symbolic, &mut z);
        let next = dot(&r, &z);
        let beta = next / rz;
        p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + beta * *p);
        rz = next;
    }
    (x, Ended::TooSlow)
}

/// Preconditioned MINRES for symmetric, possibly indefinite A x = b from x = 0; tolerance on the P⁻¹-norm of the residual.
pub fn minimum_residual(
    symbolic: &Symbolic,
    factor: &Factor,
    matrix: &BlockMatrix,
    b: &[f64],
    tolerance: f64,
    limit: usize,
) -> (Vec<f64>, Ended) {
    let n = b.len();
    let mut x = vec![0.0; n];
    let (mut r1, mut r2) = (b.to_vec(), b.to_vec());
    let mut y = b.to_vec();
    factor.solve(symbolic, &mut y);
    let start = dot(b, &y).max(0.0).sqrt();
    if start == 0.0 {
        return (x, Ended::Converged { iterations: 0 });
    }
    let (mut beta, mut old_beta, mut phi) = (start, 0.0, start);
    let (mut dbar, mut epsilon, mut cs, mut sn) = (0.0, 0.0, -1.0, 0.0);
    let (mut w, mut w2, mut v) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    let mut product = vec![0.0; n];
    for iteration in 1..=limit {
        v.iter_mut().zip(&y).for_each(|(v, y)| *v = y / beta);
        matrix.times_in_parts(symbolic, &v, &mut product);
        if iteration > 1 {
            axpy(-beta / old_beta, &r1, &mut product);
        }
        let alpha = dot(&v, &product);
        axpy(-alpha / beta, &r2, &mut product);
        std::mem::swap(&mut r1, &mut r2);
        r2.copy_from_slice(&product);
        y.copy_from_slice(&r2);
        factor.solve(symbolic, &mut y);
        old_beta = beta;
        beta = dot(&r2, &y).max(0.0).sqrt();
        // Givens rotation of the tridiagonal's new column.
        let old_epsilon = epsilon;
        let delta = cs * dbar + sn * alpha;
        let gbar = sn * dbar - cs * alpha;
        epsilon = sn * beta;
        dbar = -cs * beta;
        let gamma = gbar.hypot(beta).max(f64::MIN_POSITIVE);
        (cs, sn) = (gbar / gamma, beta / gamma);
        let step = cs * phi;
        phi *= sn;
        for i in 0..n {
            let w1 = w2[i];
            w2[i] = w[i];
            w[i] = (v[i] - old_epsilon * w1 - delta * w2[i]) / gamma;
            x[i] += step * w[i];
        }
        if phi <= tolerance * start {
            return (x, Ended::Converged { iterations: iteration });
        }
    }
    (x, Ended::TooSlow)
}

#[cfg(test)]
mod tests {
    use super::super::cholesky::tests::random_system;
    use super::*;
    use crate::gradcheck::SplitMix64;

    fn residual(matrix: &BlockMatrix, x: &[f64], b: &[f64]) -> f64 {
        let mut ax = vec![0.0; b.len()];
        matrix.times(x, &mut ax);
        axpy(-1.0, b, &mut ax);
        (dot(&ax, &ax) / dot(b, b)).sqrt()
    }

    #[test]
    fn a_neighbours_factor_makes_conjugate_gradients_short() {
        let (symbolic, mut matrix) = random_system(500, 0.17, 2);
        let mut factor = Factor::default();
        factor.factor(&symbolic, &matrix, &[]).expect("diagonally dominant");
        let mut rng = SplitMix64(8);
        matrix.blocks.iter_mut().flatten().for_each(|v| *v *= 1.0 + 0.02 * rng.normal());
        let b: Vec<f64> = (0..1500).map(|_| rng.normal()).collect();
        let (x, ended) = conjugate_gradients(&symbolic, &factor, &matrix, &b, 1e-12, 20);
        println!("{ended:?}, residual {:.1e}", residual(&matrix, &x, &b));
        assert!(residual(&matrix, &x, &b) < 1e-11 && matches!(ended, Ended::Converged { iterations: 1..=9 }));
    }

    #[test]
    fn an_indefinite_system_is_noticed_by_one_and_solved_by_the_other() {
        let (symbolic, mut matrix) = random_system(300, 0.2, 3);
        for point in [20, 170] {
            let k = matrix.pattern.column(point).start;
            matrix.blocks[k][0] = -3.0;
        }
        let mut factor = Factor::default();
        factor.factor(&symbolic, &matrix, &[6.0; 300]).expect("shifted");
        let mut rng = SplitMix64(8);
        let b: Vec<f64> = (0..900).map(|_| rng.normal()).collect();
        let (_, ended) = conjugate_gradients(&symbolic, &factor, &matrix, &b, 1e-13, 300);
        assert_eq!(ended, Ended::NegativeCurvature);
        let (x, ended) = minimum_residual(&symbolic, &factor, &matrix, &b, 1e-13, 300);
        println!("MINRES {ended:?}, residual {:.1e}", residual(&matrix, &x, &b));
        assert!(residual(&matrix, &x, &b) < 1e-11 && matches!(ended, Ended::Converged { .. }));
    }
}

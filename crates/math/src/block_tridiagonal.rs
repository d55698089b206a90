//! Cholesky factorisation of symmetric positive definite block-tridiagonal matrices.
//!
//! A chain of frames that are coupled to their next two neighbours is block-pentadiagonal; two frames a block make it
//! tridiagonal, and the dense kernels large enough to be efficient.
//! L₀L₀ᵀ = A₀;  Sᵢ = Aᵢ,ᵢ₋₁ L⁻ᵀᵢ₋₁;  LᵢLᵢᵀ = Aᵢ − SᵢSᵢᵀ (Golub & Van Loan, Matrix Computations, §4.5.1).

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::linalg::triangular_solve as solve;
use faer::{Accum, Mat, Par, Spec};

/// Symmetric matrix with blocks on the diagonal and directly below; only the lower triangle is read.
#[derive(Clone, Debug)]
pub struct BlockTridiagonal {
    /// Diagonal blocks.
    pub diagonal: Vec<Mat<f64>>,
    /// `below[i]` = block (i + 1, i).
    pub below: Vec<Mat<f64>>,
}

/// The matrix was not positive definite; the block at which that showed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("matrix is not positive definite (block {block})")]
pub struct NotPositiveDefinite {
    /// Index of the diagonal block.
    pub block: usize,
}

impl BlockTridiagonal {
    /// All zeros, for some block sizes.
    pub fn zeros(sizes: &[usize]) -> Self {
        Self {
            diagonal: sizes.iter().map(|&n| Mat::zeros(n, n)).collect(),
            below: sizes.windows(2).map(|s| Mat::zeros(s[1], s[0])).collect(),
        }
    }

    /// Solves `A x = b` for one right-hand side, destroying `self` (it becomes its factor).
    pub fn solve(self, b: &[f64]) -> Result<Vec<f64>, NotPositiveDefinite> {
        Ok(self.factored()?.solve(b))
    }

    /// Turns the matrix into its factor, for several right-hand sides.
    pub fn factored(mut self) -> Result<Factor, NotPositiveDefinite> {
        self.factor()?;
        Ok(Factor(self))
    }

    fn factor(&mut self) -> Result<(), NotPositiveDefinite> {
        for i in 0..self.diagonal.len() {
            if i > 0 {
                let (done, rest) = self.diagonal.split_at_mut(i);
                let s = &mut self.below[i - 1];
                // S = A L⁻ᵀ, computed as Sᵀ = L⁻¹ Aᵀ.
                solve::solve_lower_triangular_in_place(done[i - 1].as_ref(), s.as_mut().transpose_mut(), Par::Seq);
                triangular_matmul(
                    rest[0].as_mut(),
                    BlockStructure::TriangularLower,
                    Accum::Add,
                    s.as_ref(),
                    BlockStructure::Rectangular,
                    s.transpose(),
                    BlockStructure::Rectangular,
                    -1.0,
                    Par::Seq,
                );
            }
            let block = self.diagonal[i].as_mut();
            let n = block.nrows();
            let mut memory =
                MemBuffer::new(llt::factor::cholesky_in_place_scratch::<f64>(n, Par::Seq, Spec::default()));
            llt::factor::cholesky_in_place(
                block,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Spec::default(),
            )
            .map_err(|_| NotPositiveDefinite { block: i })?;
        }
        Ok(())
    }
}

/// The Cholesky factor of a [`BlockTridiagonal`] matrix.
#[derive(Clone, Debug)]
pub struct Factor(BlockTridiagonal);

impl Factor {
    /// Solves `A x = b`.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let mut x: Vec<Mat<f64>> = Vec::with_capacity(self.0.diagonal.len());
        let mut start = 0;
        for (i, l) in self.0.diagonal.iter().enumerate() {
            let n = l.nrows();
            let mut y = Mat::from_fn(n, 1, |r, _| b[start + r]);
            if i > 0 {
                y -= &self.0.below[i - 1] * &x[i - 1];
            }
            solve::solve_lower_triangular_in_place(l.as_ref(), y.as_mut(), Par::Seq);
            x.push(y);
            start += n;
        }
        for i in (0..x.len()).rev() {
            if i + 1 < x.len() {
                let correction = self.0.below[i].transpose() * &x[i + 1];
                x[i] -= correction;
            }
            solve::solve_upper_triangular_in_place(self.0.diagonal[i].transpose(), x[i].as_mut(), Par::Seq);
        }
        x.iter().flat_map(|y| (0..y.nrows()).map(|r| y[(r, 0)])).collect()
    }

    /// Diagonal blocks of A⁻¹, without the rest of it:
    /// Zᵢᵢ = Lᵢ⁻ᵀ (I + Sᵢ₊₁ᵀ Zᵢ₊₁,ᵢ₊₁ Sᵢ₊₁) Lᵢ⁻¹, from the last block up (Takahashi, Fagan & Chin 1973).
    pub fn inverse_diagonal(&self) -> Vec<Mat<f64>> {
        let mut inverse: Vec<Mat<f64>> = Vec::with_capacity(self.0.diagonal.len());
        for (i, l) in self.0.diagonal.iter().enumerate().rev() {
            let mut block = Mat::identity(l.nrows(), l.nrows());
            if let Some(later) = inverse.last() {
                let s = &self.0.below[i];
                block += s.transpose() * (later * s);
            }
            // Twice, for the middle is symmetric: L⁻ᵀ M, and L⁻ᵀ of that transposed.
            for _ in 0..2 {
                solve::solve_upper_triangular_in_place(l.transpose(), block.as_mut(), Par::Seq);
                block = block.transpose().to_owned();
            }
            inverse.push(block);
        }
        inverse.reverse();
        inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradcheck::SplitMix64;

    const SIZES: [usize; 3] = [5, 5, 3];

    /// A random positive definite matrix, and the same dense.
    fn example() -> (BlockTridiagonal, Mat<f64>) {
        let n: usize = SIZES.iter().sum();
        let mut rng = SplitMix64(7);
        let mut a = BlockTridiagonal::zeros(&SIZES);
        let mut dense = Mat::<f64>::zeros(n, n);
        let starts = [0, 5, 10];
        for (i, &size) in SIZES.iter().enumerate() {
            let m = Mat::from_fn(size, size, |_, _| rng.normal());
            a.diagonal[i] = &m * m.transpose() + Mat::<f64>::identity(size, size) * faer::Scale(4.0);
            for r in 0..size {
                for c in 0..size {
                    dense[(starts[i] + r, starts[i] + c)] = a.diagonal[i][(r, c)];
                }
            }
        }
        for (i, below) in a.below.iter_mut().enumerate() {
            for r in 0..below.nrows() {
                for c in 0..below.ncols() {
                    below[(r, c)] = 0.3 * rng.normal();
                    dense[(starts[i + 1] + r, starts[i] + c)] = below[(r, c)];
                    dense[(starts[i] + c, starts[i + 1] + r)] = below[(r, c)];
                }
            }
        }
        (a, dense)
    }

    #[test]
    fn solves_what_a_dense_product_made() {
        let (a, dense) = example();
        let n = dense.nrows();
        let mut rng = SplitMix64(8);
        let truth = Mat::from_fn(n, 1, |_, _| rng.normal());
        let b = &dense * &truth;
        let b: Vec<f64> = (0..n).map(|i| b[(i, 0)]).collect();
        let x = a.solve(&b).expect("positive definite");
        let worst = (0..n).map(|i| (x[i] - truth[(i, 0)]).abs()).fold(0.0, f64::max);
        println!("largest error {worst:.1e}");
        assert!(worst < 1e-12);
    }

    #[test]
    fn the_inverse_has_the_diagonal_blocks_of_the_dense_one() {
        let (a, dense) = example();
        let factor = a.factored().expect("positive definite");
        let mut start = 0;
        let mut worst: f64 = 0.0;
        for block in factor.inverse_diagonal() {
            for c in 0..block.ncols() {
                let unit: Vec<f64> = (0..dense.nrows()).map(|i| f64::from(i == start + c)).collect();
                let column = factor.solve(&unit);
                worst = (0..block.nrows()).map(|r| (block[(r, c)] - column[start + r]).abs()).fold(worst, f64::max);
                // And the column is one of the inverse of the dense matrix.
                let x = Mat::from_fn(column.len(), 1, |r, _| column[r]);
                let back = &dense * &x;
                worst = (0..unit.len()).map(|r| (back[(r, 0)] - unit[r]).abs()).fold(worst, f64::max);
            }
            start += block.nrows();
        }
        println!("largest error {worst:.1e}");
        assert!(worst < 1e-12 && start == dense.nrows());
    }

    #[test]
    fn an_indefinite_matrix_is_named_by_its_block() {
        let mut a = BlockTridiagonal::zeros(&[2, 2]);
        a.diagonal[0] = Mat::identity(2, 2);
        a.diagonal[1][(0, 0)] = -1.0;
        a.diagonal[1][(1, 1)] = 1.0;
        assert_eq!(a.solve(&[1.0; 4]), Err(NotPositiveDefinite { block: 1 }));
    }
}

//! JᵀWJ and JᵀWr of a few parameters, dense.

use animimic_math::small_spd::solve_spd_of_any_size;

/// Normal equations.
#[derive(Clone, Debug)]
pub(super) struct Normal {
    pub matrix: Vec<Vec<f64>>,
    pub gradient: Vec<f64>,
}

impl Normal {
    pub fn zeros(n: usize) -> Self {
        Self { matrix: vec![vec![0.0; n]; n], gradient: vec![0.0; n] }
    }

    /// Adds weight (r + row·δ)².
    pub fn add(&mut self, row: &[f64], residual: f64, weight: f64) {
        for (i, a) in row.iter().enumerate() {
            self.gradient[i] += weight * a * residual;
            row.iter().zip(&mut self.matrix[i]).for_each(|(b, m)| *m += weight * a * b);
        }
    }

    /// Adds another system of the same parameters.
    pub fn add_all(&mut self, other: &Self) {
        self.gradient.iter_mut().zip(&other.gradient).for_each(|(a, b)| *a += b);
        for (row, from) in self.matrix.iter_mut().zip(&other.matrix) {
            row.iter_mut().zip(from).for_each(|(a, b)| *a += b);
        }
    }

    /// Adds a prior with a precision, `away` from its centre.
    pub fn add_prior(&mut self, i: usize, away: f64, precision: f64) {
        self.matrix[i][i] += precision;
        self.gradient[i] += precision * away;
    }

    /// The system in which parameters of one cluster change together: PᵀNP, Pᵀg.
    pub fn merged(&self, cluster: &[u32], clusters: usize) -> Self {
        let mut out = Self::zeros(clusters);
        for (i, &a) in cluster.iter().enumerate() {
            out.gradient[a as usize] += self.gradient[i];
            for (j, &b) in cluster.iter().enumerate() {
                out.matrix[a as usize][b as usize] += self.matrix[i][j];
            }
        }
        out
    }

    /// (N + damping diag N)⁻¹ g; N has a prior on every diagonal entry, so it is positive definite.
    pub fn solve(&self, damping: f64) -> Vec<f64> {
        self.solved(damping, self.gradient.clone())
    }

    /// (N + damping diag N)⁻¹ b; nothing where N holds what is no number.
    fn solved(&self, damping: f64, b: Vec<f64>) -> Vec<f64> {
        let (mut m, n) = (self.matrix.clone(), b.len());
        (0..n).for_each(|i| m[i][i] *= 1.0 + damping);
        solve_spd_of_any_size(m, b).unwrap_or_else(|| vec![0.0; n])
    }

    /// What the minimum of the model lies below its value here: gᵀN⁻¹g.
    pub fn promise(&self) -> f64 {
        self.solve(0.0).iter().zip(&self.gradient).map(|(d, g)| d * g).sum()
    }

    /// Square roots of the diagonal of N⁻¹.
    pub fn deviations(&self) -> Vec<f64> {
        let n = self.gradient.len();
        let unit = |i: usize| (0..n).map(|j| f64::from(u8::from(i == j))).collect::<Vec<_>>();
        (0..n).map(|i| self.solved(0.0, unit(i))[i].max(0.0).sqrt()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn merged_parameters_are_those_of_rows_that_were_added_up() {
        let rows = [[1.0, 2.0, -1.0], [0.5, -3.0, 2.0], [4.0, 0.1, 0.2]];
        let (mut fine, mut coarse) = (Normal::zeros(3), Normal::zeros(2));
        for (k, row) in rows.iter().enumerate() {
            fine.add(row, k as f64 - 0.7, 1.3);
            coarse.add(&[row[0] + row[2], row[1]], k as f64 - 0.7, 1.3);
        }
        let merged = fine.merged(&[0, 1, 0], 2);
        let error = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(error(&merged.gradient, &coarse.gradient) < 1e-12);
        assert!((0..2).all(|i| error(&merged.matrix[i], &coarse.matrix[i]) < 1e-12));
        let step = coarse.solve(0.0);
        let back: Vec<f64> = (0..2).map(|i| coarse.matrix[i].iter().zip(&step).map(|(m, s)| m * s).sum()).collect();
        assert!(error(&back, &coarse.gradient) < 1e-10 && coarse.promise() > 0.0);
    }
}

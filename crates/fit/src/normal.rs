//! Normal equations of one frame: H = Σ w Jᵀ J and g = Σ w Jᵀ r, accumulated row by row.

/// Lower triangle of H (row-major) and g for one frame's parameters.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    /// Parameters.
    pub dimension: usize,
    /// H, row-major; only entries with column ≤ row are kept.
    pub hessian: Vec<f64>,
    /// g = half the gradient of the energy Σ w r².
    pub gradient: Vec<f64>,
}

impl NormalEquations {
    /// All zeros.
    pub fn zeros(dimension: usize) -> Self {
        Self { dimension, hessian: vec![0.0; dimension * dimension], gradient: vec![0.0; dimension] }
    }

    /// Adds w (r + J δ)²: a sparse row with ascending parameter indices.
    pub fn add_row(&mut self, row: &[(usize, f64)], residual: f64, weight: f64) {
        for (k, &(i, a)) in row.iter().enumerate() {
            let wa = weight * a;
            self.gradient[i] += wa * residual;
            let line = &mut self.hessian[i * self.dimension..][..=i];
            for &(j, b) in &row[..=k] {
                line[j] += wa * b;
            }
        }
    }

    /// Adds w · a aᵀ to H alone, for a dense vector; negative weights take information away (variable projection).
    pub fn add_outer(&mut self, a: &[f64], weight: f64) {
        for i in 0..self.dimension {
            if a[i] != 0.0 {
                let wa = weight * a[i];
                let line = &mut self.hessian[i * self.dimension..][..=i];
                line.iter_mut().zip(a).for_each(|(h, b)| *h += wa * b);
            }
        }
    }
}

//! What a body is made of.

use crate::error::{SimError, check_len};
use crate::models::Model;

/// Elastic parameters of a body: one modulus per cluster of tets.
#[derive(Clone, Debug, PartialEq)]
pub struct Elasticity {
    /// Constitutive model.
    pub model: Model,
    /// Cluster of each tet.
    pub cluster: Vec<u32>,
    /// ln of Young's modulus [ln Pa], per cluster.
    pub ln_youngs: Vec<f64>,
    /// Poisson's ratio, −1 < ν < 0.5.
    pub poisson: f64,
    /// Density [kg/m³].
    pub density: f64,
}

impl Elasticity {
    /// One material everywhere; `youngs` in Pa.
    pub fn uniform(model: Model, tets: usize, youngs: f64, poisson: f64, density: f64) -> Self {
        Self { model, cluster: vec![0; tets], ln_youngs: vec![youngs.ln()], poisson, density }
    }

    /// A modulus of its own for every tet [Pa].
    pub fn per_tet(model: Model, youngs: &[f64], poisson: f64, density: f64) -> Self {
        let ln_youngs = youngs.iter().map(|e| e.ln()).collect();
        Self { model, cluster: (0..youngs.len() as u32).collect(), ln_youngs, poisson, density }
    }

    /// Checks every range; the error names the tet or the cluster.
    pub fn validate(&self, tets: usize) -> Result<(), SimError> {
        check_len("cluster of each tet", self.cluster.len(), tets)?;
        let clusters = self.ln_youngs.len();
        if let Some(tet) = self.cluster.iter().position(|&c| c as usize >= clusters) {
            return Err(SimError::ClusterOutOfRange { tet, cluster: self.cluster[tet], clusters });
        }
        if let Some(cluster) = self.ln_youngs.iter().position(|l| !(l.exp() > 0.0 && l.exp().is_finite())) {
            // ln of a negative modulus is NaN: that is how a negative E arrives here.
            return Err(SimError::Modulus { cluster, value: self.ln_youngs[cluster].exp() });
        }
        if !(self.poisson > -1.0 && self.poisson < 0.5) {
            return Err(SimError::OutOfRange { name: "Poisson's ratio", value: self.poisson, range: "in (−1, 0.5)" });
        }
        if !(self.density > 0.0 && self.density.is_finite()) {
            return Err(SimError::OutOfRange { name: "density", value: self.density, range: "positive [kg/m³]" });
        }
        Ok(())
    }

    /// Lamé parameters (μ, λ) at E = 1 Pa: μ = 1/(2(1+ν)), λ = ν/((1+ν)(1−2ν)).
    pub fn unit_lame(&self) -> [f64; 2] {
        let n = self.poisson;
        [0.5 / (1.0 + n), n / ((1.0 + n) * (1.0 - 2.0 * n))]
    }

    /// ∂(μ, λ)/∂ν at E = 1 Pa.
    pub fn unit_lame_by_poisson(&self) -> [f64; 2] {
        let n = self.poisson;
        let d = (1.0 + n) * (1.0 - 2.0 * n);
        [-0.5 / (1.0 + n).powi(2), (1.0 + 2.0 * n * n) / (d * d)]
    }
}

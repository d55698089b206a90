//! What is known of the soft surface: the family of evidence that a material is fitted to.
//!
//! E = Σ w ρ(r) + Σ L over frames: scalar residuals r of surface points, for Gauss–Newton, and losses L of pictures with their
//! gradient. What both are worth against a prior is said in independent observations: residuals of one picture are not.

use crate::robust::Robust;
use glam::DVec3;

/// One scalar comparison of the surface with what is seen.
#[derive(Clone, Copy, Debug)]
pub struct Residual {
    /// r: model less observation, in the evidence's unit.
    pub value: f64,
    /// w.
    pub weight: f64,
    /// ρ.
    pub robust: Robust,
    /// ∂r/∂x for up to three vertices of the surface [unit / model unit].
    pub gradient: [(u32, DVec3); 3],
}

impl Residual {
    /// w ρ(r).
    pub fn energy(&self) -> f64 {
        self.weight * self.robust.loss(self.value.abs())
    }
}

/// What is known of the surface in the frames of a clip.
pub trait Evidence: Sync {
    /// Residuals of a frame's surface [model unit]: the same ones, in the same order, for all surfaces.
    fn residuals(&self, frame: usize, surface: &[DVec3]) -> Vec<Residual>;

    /// The loss of a frame's picture, and its gradient to the surface [1 / model unit] where asked for.
    fn rendered(&self, _frame: usize, _surface: &[DVec3], _gradient: bool) -> (f64, Vec<DVec3>) {
        (0.0, Vec::new())
    }

    /// How many independent observations all frames together are worth.
    fn observations(&self) -> f64;
}

/// Known positions of some vertices.
pub struct Positions<'a> {
    /// Positions \[frame\]\[vertex\] [model unit].
    pub frames: &'a [Vec<DVec3>],
    /// Weight of each vertex; 0 leaves it out.
    pub weights: &'a [f64],
}

impl Evidence for Positions<'_> {
    fn residuals(&self, frame: usize, surface: &[DVec3]) -> Vec<Residual> {
        let Some(target) = self.frames.get(frame) else { return Vec::new() };
        let counted = (0..surface.len()).filter(|&v| self.weights[v] > 0.0);
        let of = |v: usize| {
            DVec3::AXES.map(|axis| Residual {
                value: axis.dot(surface[v] - target[v]),
                weight: self.weights[v],
                robust: Robust::Squared,
                gradient: [(v as u32, axis), (v as u32, DVec3::ZERO), (v as u32, DVec3::ZERO)],
            })
        };
        counted.flat_map(of).collect()
    }

    fn observations(&self) -> f64 {
        3.0 * self.weights.iter().sum::<f64>() * self.frames.len() as f64
    }
}

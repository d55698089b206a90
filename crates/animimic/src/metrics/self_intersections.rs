//! Self-intersections: pairs of faces that cross, minus those at rest (generated meshes start above 0).

use super::{Evidence, Metric, Missing, Reading, mean};
use crate::crossings::Crossings;
use rayon::prelude::*;

pub struct SelfIntersections;

impl Metric for SelfIntersections {
    fn name(&self) -> &'static str {
        "self-intersections"
    }

    fn definition(&self) -> &'static str {
        "pairs of faces without a common vertex that cross, minus those at rest, mean and max over frames"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let crossings = Crossings::new(&e.asset.mesh);
        let counts: Vec<f64> = e.frames.par_iter().map(|f| crossings.count(f) as f64).collect();
        let rest = crossings.count(&e.asset.mesh.positions) as f64;
        Ok(vec![
            ("self_intersections_rest".into(), rest),
            ("self_intersections_mean".into(), mean(counts.iter().map(|c| c - rest))),
            ("self_intersections_max".into(), counts.iter().copied().fold(0.0, f64::max) - rest),
        ])
    }
}

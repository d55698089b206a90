//! Completeness: how much of the truth's motion the result has. Catches a static "solution".

use super::{Evidence, Metric, Missing, Reading, mean};
use glam::DVec3;

pub struct Completeness;

impl Metric for Completeness {
    fn name(&self) -> &'static str {
        "completeness"
    }

    fn definition(&self) -> &'static str {
        "mean |x[t] − x[0]| over frames and vertices, as a ratio to the truth's"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let truth = motion(&e.need_truth()?.vertices);
        Ok(vec![("completeness".into(), motion(e.frames) / truth.max(1e-12))])
    }
}

fn motion(frames: &[Vec<DVec3>]) -> f64 {
    mean(frames.iter().flat_map(|f| f.iter().zip(&frames[0])).map(|(a, b)| a.distance(*b)))
}

#[cfg(test)]
mod tests {
    use super::super::fixtures;
    use super::*;
    use crate::truth::Truth;

    #[test]
    fn half_the_motion_has_completeness_one_half() {
        let (asset, result) = fixtures::sliding(0.05, 4);
        let truth = Truth { vertices: fixtures::sliding(0.1, 4).1, ..Default::default() };
        let e = Evidence { truth: Some(&truth), ..fixtures::evidence(&asset, &result) };
        let c = Completeness.measure(&e).unwrap()[0].1;
        println!("{c}");
        assert!((c - 0.5).abs() < 1e-12);
    }
}

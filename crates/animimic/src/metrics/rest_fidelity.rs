//! Rest fidelity: the output's own rest against the input model: it must be the same thing in the same place.

use super::{Evidence, Metric, Missing, Reading};
use glam::DVec3;

pub struct RestFidelity;

impl Metric for RestFidelity {
    fn name(&self) -> &'static str {
        "rest fidelity"
    }

    fn definition(&self) -> &'static str {
        "max distance between the rest vertices (displayed, and as stored) of result and input, in diagonals; must be < 1e-5"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let input = e.input.ok_or(Missing("needs the input model"))?;
        let (own, theirs) = (&e.asset.mesh.positions, &input.mesh.positions);
        if own.len() != theirs.len() {
            return Err(Missing("vertex buffers differ"));
        }
        let diagonal = super::diagonal(theirs).max(f64::MIN_POSITIVE);
        let worst = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(p, q)| p.distance(*q)).fold(0.0, f64::max);
        let stored = |asset: &animimic_scene::Asset| asset.rig.skin.bind_positions.clone();
        Ok(vec![
            ("rest_fidelity".into(), worst(own, theirs) / diagonal),
            ("bind_fidelity".into(), worst(&stored(e.asset), &stored(input)) / diagonal),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixtures;
    use super::*;

    #[test]
    fn a_result_that_stands_elsewhere_is_told() {
        let (asset, frames) = fixtures::sliding(0.0, 1);
        let mut input = asset.clone();
        let e = Evidence { input: Some(&asset), ..fixtures::evidence(&asset, &frames) };
        assert_eq!(RestFidelity.measure(&e).unwrap()[0].1, 0.0);
        input.mesh.positions[0].x += 12f64.sqrt() * 0.01;
        let e = Evidence { input: Some(&input), ..fixtures::evidence(&asset, &frames) };
        let f = RestFidelity.measure(&e).unwrap()[0].1;
        println!("{f}");
        assert!(f > 0.008 && f < 0.01);
    }
}

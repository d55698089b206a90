//! Jitter: mean acceleration, as a ratio to the truth's own. Zero motion wins: read it with completeness.

use super::{Evidence, Metric, Missing, Reading, mean};
use glam::DVec3;

pub struct Jitter;

impl Metric for Jitter {
    fn name(&self) -> &'static str {
        "jitter"
    }

    fn definition(&self) -> &'static str {
        "mean |x[t+1] − 2x[t] + x[t−1]|·fps² / diagonal, as a ratio to the truth's; absolute [1/s²] where there is no truth"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        if e.frames.len() < 3 {
            return Err(Missing("needs three frames"));
        }
        let own = acceleration(e.frames);
        Ok(match e.truth {
            Some(t) => vec![("jitter".into(), own / acceleration(&t.vertices).max(1e-12))],
            None => vec![("acceleration_per_s2".into(), own * e.fps * e.fps / e.diagonal().max(f64::MIN_POSITIVE))],
        })
    }
}

fn acceleration(frames: &[Vec<DVec3>]) -> f64 {
    mean(frames.windows(3).flat_map(|w| (0..w[0].len()).map(move |i| (w[2][i] - 2.0 * w[1][i] + w[0][i]).length())))
}

#[cfg(test)]
mod tests {
    use super::super::fixtures;
    use super::*;

    #[test]
    fn uniform_motion_has_no_jitter_and_a_parabola_has_its_acceleration() {
        let (asset, mut frames) = fixtures::sliding(0.1, 6);
        let still = Jitter.measure(&fixtures::evidence(&asset, &frames)).unwrap()[0].1;
        // x = 3/2 t² has acceleration 3 a second²; the octahedron's diagonal is 2√3.
        for (t, f) in frames.iter_mut().enumerate() {
            let s = t as f64 / 24.0;
            f.iter_mut().zip(&asset.mesh.positions).for_each(|(x, r)| *x = *r + DVec3::X * (1.5 * s * s));
        }
        let parabola = Jitter.measure(&fixtures::evidence(&asset, &frames)).unwrap()[0].1;
        println!("{still} {parabola}");
        assert!(still < 1e-9);
        assert!((parabola - 3.0 / 12f64.sqrt()).abs() < 1e-9);
    }
}

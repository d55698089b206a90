//! Foot sliding: how far points that touch the ground drift along it.
//!
//! The ground is the lowest point of the whole clip. A point is in contact from t to t + 1 when it stays within 1 % of the
//! diagonal of the ground in both frames. A walk on the spot slides by nature: compare with the truth's own figure.

use super::{Evidence, Metric, Missing, Reading, mean};
use glam::DVec3;

pub struct FootSliding;

/// Height above the ground that still counts as contact, in diagonals.
const CONTACT: f64 = 0.01;

impl Metric for FootSliding {
    fn name(&self) -> &'static str {
        "foot sliding"
    }

    fn definition(&self) -> &'static str {
        "mean horizontal drift a frame of points within 1 % of the diagonal of the clip's lowest point, in % of the diagonal; the truth's own beside it"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        if e.frames.len() < 2 {
            return Err(Missing("needs two frames"));
        }
        let diagonal = e.diagonal();
        let mut out = vec![("foot_sliding_pct".into(), 100.0 * sliding(e.frames, diagonal) / diagonal)];
        if let Some(t) = e.truth {
            out.push(("foot_sliding_truth_pct".into(), 100.0 * sliding(&t.vertices, diagonal) / diagonal));
        }
        Ok(out)
    }
}

/// Mean drift per contact and frame [model unit].
fn sliding(frames: &[Vec<DVec3>], diagonal: f64) -> f64 {
    let ground = frames.iter().flatten().map(|p| p.y).fold(f64::INFINITY, f64::min);
    let low = |p: &DVec3| p.y <= ground + CONTACT * diagonal;
    mean(frames.windows(2).flat_map(|w| {
        w[0].iter().zip(&w[1]).filter(|(a, b)| low(a) && low(b)).map(|(a, b)| (*b - *a).with_y(0.0).length())
    }))
}

#[cfg(test)]
mod tests {
    use super::super::fixtures;
    use super::*;

    #[test]
    fn only_the_point_on_the_ground_slides_and_by_its_own_step() {
        let (asset, frames) = fixtures::sliding(0.05, 4);
        let s = FootSliding.measure(&fixtures::evidence(&asset, &frames)).unwrap()[0].1;
        println!("{s}");
        assert!((s - 5.0 / 12f64.sqrt()).abs() < 1e-9);
    }
}

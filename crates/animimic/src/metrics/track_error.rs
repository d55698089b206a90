//! Track error: pixel distance of surface points to where the truth projects them, visible points only.

use super::{Evidence, Metric, Missing, Reading, mean, percentile};

pub struct TrackError;

impl Metric for TrackError {
    fn name(&self) -> &'static str {
        "track error"
    }

    fn definition(&self) -> &'static str {
        "mean and p95 distance [px] between the projections of result and truth, over the vertices visible in each frame of the truth"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let truth = e.need_truth()?;
        let camera = e.camera.ok_or(Missing("needs a camera"))?;
        let mut distances = Vec::new();
        for ((own, real), visible) in e.frames.iter().zip(&truth.vertices).zip(&truth.visible) {
            for ((a, b), seen) in own.iter().zip(real).zip(visible) {
                if *seen {
                    distances.push(camera.project(*a).distance(camera.project(*b)));
                }
            }
        }
        if distances.is_empty() {
            return Err(Missing("the truth does not say what is visible"));
        }
        Ok(vec![
            ("track_mean_px".into(), mean(distances.iter().copied())),
            ("track_p95_px".into(), percentile(distances, 95.0)),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixtures;
    use super::*;
    use crate::truth::Truth;
    use glam::DVec3;

    #[test]
    fn only_visible_points_count_and_their_distance_is_in_pixels() {
        let (asset, result) = fixtures::sliding(0.0, 1);
        let mut moved = result.clone();
        moved[0][4].x += 0.1; // (0, 0, 1): 4 units before the camera
        moved[0][5].x += 9.0; // hidden
        let mut seen = vec![false; 6];
        seen[4] = true;
        let truth = Truth { vertices: moved, visible: vec![seen], ..Default::default() };
        let camera = animimic_scene::Camera::orbit(DVec3::ZERO, 5.0, 0.0, 0.0, 0.8, 64, 64);
        let e = Evidence { truth: Some(&truth), camera: Some(&camera), ..fixtures::evidence(&asset, &result) };
        let r = TrackError.measure(&e).unwrap();
        println!("{r:?}, expected {}", camera.fx * 0.1 / 4.0);
        assert!((r[0].1 - camera.fx * 0.1 / 4.0).abs() < 1e-9);
    }
}

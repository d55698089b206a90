//! How far posed vertices are from where they should be.

use animimic_scene::{Motion, Rig, Trajectory};
use glam::DVec3;
use rayon::prelude::*;

/// Distances over all frames and vertices, in shares of the rest diagonal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Residual {
    /// Root mean square.
    pub rms: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub largest: f64,
}

impl Residual {
    /// Of distances in model units; `diagonal` is the rest bounding box's.
    pub fn of_distances(mut distances: Vec<f64>, diagonal: f64) -> Self {
        if distances.is_empty() || diagonal <= 0.0 {
            return Self::default();
        }
        let squares: f64 = distances.iter().map(|d| d * d).sum();
        let rms = (squares / distances.len() as f64).sqrt() / diagonal;
        let largest = distances.iter().copied().fold(0.0, f64::max) / diagonal;
        let at = (0.99 * (distances.len() - 1) as f64).round() as usize;
        let (_, p99, _) = distances.select_nth_unstable_by(at, f64::total_cmp);
        Self { rms, p99: *p99 / diagonal, largest }
    }

    /// Of a rig's skinned clips against trajectories.
    pub fn of_clips<'a>(
        rig: &Rig,
        diagonal: f64,
        clips: impl IntoIterator<Item = (&'a Motion, &'a Trajectory)>,
    ) -> Self {
        let distances = clips.into_iter().flat_map(|(motion, trajectory)| {
            let frames: Vec<Vec<f64>> = (0..motion.poses.len().min(trajectory.frames.len()))
                .into_par_iter()
                .map(|f| {
                    let posed = rig.in_pose(&motion.poses[f]);
                    distances(&posed, &trajectory.frames[f])
                })
                .collect();
            frames.into_iter().flatten()
        });
        Self::of_distances(distances.collect(), diagonal)
    }
}

/// Distances between two lists of points.
pub fn distances(a: &[DVec3], b: &[DVec3]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hundredth_of_far_points_is_the_percentile_and_all_count_in_the_rms() {
        let mut d = vec![1.0; 990];
        d.extend([5.0; 10]);
        let r = Residual::of_distances(d, 10.0);
        println!("{r:?}");
        assert!((r.rms - (124.0f64 / 100.0).sqrt() / 10.0).abs() < 1e-12 && r.largest == 0.5 && r.p99 == 0.1);
        assert_eq!(Residual::of_distances(Vec::new(), 1.0), Residual::default());
    }
}

//! What "good" means, one file per measure.
//!
//! A [`Metric`] looks at the [`Evidence`] and gives named numbers, or says in one sentence what it lacks.
//! Percentages are of the rest bounding-box diagonal; rest = frame 0 of the truth where there is truth, else of the result.

mod completeness;
mod foot_sliding;
mod jitter;
mod mask_iou;
mod mpjpe;
mod psnr;
mod rest_fidelity;
mod self_intersections;
pub mod skeleton_distance;
mod ssim;
mod track_error;
mod vertex_error;
mod volume_change;

pub use volume_change::enclosed_volume;

use crate::truth::Truth;
use animimic_scene::{Asset, Camera, Image, Mask};
use glam::DVec3;

/// One measure of quality.
pub trait Metric: Sync {
    /// Short name, as `animimic list metrics` prints it.
    fn name(&self) -> &'static str;
    /// The exact definition in one sentence.
    fn definition(&self) -> &'static str;
    /// The numbers by their JSON keys, or what is missing.
    fn measure(&self, evidence: &Evidence) -> Result<Vec<Reading>, Missing>;
}

/// One number of a metric: its JSON key and value.
pub type Reading = (String, f64);

/// Why a metric has nothing to say about this evidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Missing(pub &'static str);

/// All metrics, in the order in which they are printed.
pub const METRICS: &[&dyn Metric] = &[
    &vertex_error::VertexError,
    &mpjpe::Mpjpe,
    &mask_iou::MaskIou,
    &completeness::Completeness,
    &jitter::Jitter,
    &track_error::TrackError,
    &psnr::Psnr,
    &ssim::Ssim,
    &self_intersections::SelfIntersections,
    &volume_change::VolumeChange,
    &foot_sliding::FootSliding,
    &rest_fidelity::RestFidelity,
    &skeleton_distance::SkeletonDistance,
];

/// Everything that a metric may look at.
pub struct Evidence<'a> {
    /// The animated asset.
    pub asset: &'a Asset,
    /// The model that the animation was made for, where known.
    pub input: Option<&'a Asset>,
    /// Vertices of the result, world space, \[frame\]\[vertex\].
    pub frames: &'a [Vec<DVec3>],
    /// Joints of the result, world space, \[frame\]\[joint of the rig\].
    pub joints: &'a [Vec<DVec3>],
    /// Frames per second.
    pub fps: f64,
    /// Exact truth.
    pub truth: Option<&'a Truth>,
    /// The input camera.
    pub camera: Option<&'a Camera>,
    /// Silhouettes to compare.
    pub silhouettes: &'a [SilhouettePair],
    /// Pictures to compare.
    pub pictures: Option<&'a PicturePair>,
}

/// Silhouettes of result and reference in one view, frame by frame.
pub struct SilhouettePair {
    /// View name: `main`, `novel_p45`, …
    pub view: String,
    /// Of the result \[frame\].
    pub result: Vec<Mask>,
    /// Of the truth, or as segmented in the video \[frame\].
    pub reference: Vec<Mask>,
}

/// Pictures of result and video, frame by frame, of one size.
pub struct PicturePair {
    /// Rendered \[frame\].
    pub result: Vec<Image>,
    /// From the video \[frame\].
    pub reference: Vec<Image>,
    /// Where the object is \[frame\]: the box of these pixels is compared on its own.
    pub object: Vec<Mask>,
}

impl Evidence<'_> {
    /// The rest shape that lengths are compared to.
    fn rest(&self) -> &[DVec3] {
        self.truth.map_or_else(|| self.frames.first().map_or(&[][..], |f| f), |t| &t.vertices[0])
    }

    /// Rest bounding-box diagonal [model unit].
    fn diagonal(&self) -> f64 {
        diagonal(self.rest())
    }

    /// The truth, or the reason for silence.
    fn need_truth(&self) -> Result<&Truth, Missing> {
        self.truth.ok_or(Missing("needs truth (--truth DIR)"))
    }
}

/// Bounding-box diagonal of some points.
pub fn diagonal(points: &[DVec3]) -> f64 {
    let (lo, hi) = animimic_scene::mesh::bounds(points);
    (hi - lo).length()
}

/// Measures all: the readings in order, and what each silent metric lacks.
pub fn measure(evidence: &Evidence) -> (Vec<Reading>, Vec<(&'static str, &'static str)>) {
    let (mut readings, mut missing) = (Vec::new(), Vec::new());
    for metric in METRICS {
        match metric.measure(evidence) {
            Ok(r) => readings.extend(r),
            Err(Missing(why)) => missing.push((metric.name(), why)),
        }
    }
    missing.push(("lpips", "needs a network's weights, of which none are built in"));
    (readings, missing)
}

/// Arithmetic mean; 0 of nothing.
fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for v in values {
        sum += v;
        n += 1;
    }
    if n == 0 { 0.0 } else { sum / n as f64 }
}

/// Percentile `p` in \[0, 100\] with linear interpolation between ranks (numpy's default); 0 of nothing.
fn percentile(mut values: Vec<f64>, p: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    values.sort_unstable_by(f64::total_cmp);
    let rank = p / 100.0 * (values.len() - 1) as f64;
    let (low, high) = (rank.floor() as usize, rank.ceil() as usize);
    values[low] + (values[high] - values[low]) * (rank - low as f64)
}

#[cfg(test)]
pub(crate) mod fixtures {
    //! A ball of two triangles strips' worth of octahedra, moved by known amounts.
    use super::*;
    use animimic_scene::Mesh;

    /// Octahedron of radius 1 about the origin, outward triangles.
    pub fn octahedron() -> Mesh {
        let positions = vec![DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
        let triangles = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
        Mesh { welded: (0..6).collect(), welded_count: 6, positions, triangles, ..Default::default() }
    }

    /// The octahedron sliding along x by `step` a frame.
    pub fn sliding(step: f64, frames: usize) -> (Asset, Vec<Vec<DVec3>>) {
        let mesh = octahedron();
        let moved =
            (0..frames).map(|t| mesh.positions.iter().map(|p| *p + DVec3::X * (step * t as f64)).collect()).collect();
        (Asset { mesh, ..Default::default() }, moved)
    }

    /// Evidence without truth or pictures.
    pub fn evidence<'a>(asset: &'a Asset, frames: &'a [Vec<DVec3>]) -> Evidence<'a> {
        Evidence {
            asset,
            input: None,
            frames,
            joints: &[],
            fps: 24.0,
            truth: None,
            camera: None,
            silhouettes: &[],
            pictures: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_metric_has_its_own_name_and_definition_and_gives_finite_numbers_or_a_reason() {
        let (asset, frames) = fixtures::sliding(0.1, 5);
        let evidence = fixtures::evidence(&asset, &frames);
        let mut names = Vec::new();
        for metric in METRICS {
            names.push(metric.name());
            assert!(metric.definition().len() > 20, "{}", metric.name());
            match metric.measure(&evidence) {
                Ok(readings) => {
                    for (key, value) in readings {
                        println!("{key} {value}");
                        assert!(value.is_finite(), "{key} = {value}");
                    }
                }
                Err(Missing(why)) => assert!(!why.is_empty()),
            }
        }
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), METRICS.len());
    }

    #[test]
    fn percentiles_interpolate_between_ranks_as_numpy_does() {
        // numpy.percentile([3, 1, 4, 1, 5, 9, 2, 6], 95) = 7.95
        let p = percentile(vec![3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0], 95.0);
        println!("{p}");
        assert!((p - 7.95).abs() < 1e-12);
    }
}

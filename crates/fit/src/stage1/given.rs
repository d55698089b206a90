//! Cues made elsewhere: point tracks and depth maps, as targets of surface points.
//!
//! A track belongs to the surface point that its pixel hits in its query frame: the rest pose for frame 0, the solved pose for
//! later ones. Its depth, and that of every point found by flow, is read from the depth map at the pixel where it is now.

use super::correspond::{Correspondences, DEPTH_STEP, near_edge};
use super::sight::{Point, Sight};
use super::subject::Subject;
use crate::terms::{DepthTarget, PixelTarget};
use animimic_scene::{Camera, DepthKind, DepthMap, Tracks};
use glam::{DMat3, DVec2, DVec3};
use std::sync::OnceLock;

/// A frame with at least this many points of given tracks needs no flow.
const ENOUGH_POINTS: usize = 100;
/// Standard deviation that given depth is taken to have [rest diagonal].
const DEPTH_SIGMA: f64 = 0.003;
/// How far outside a triangle a pixel of it may come to lie, in barycentric coordinates: pixels hit triangles at their centres.
const OVERHANG: f64 = 0.5;

/// Tracks and depth with what was derived from them.
pub struct Given<'a> {
    tracks: Option<&'a Tracks>,
    /// Surface point of each track, once its query frame is solved; `None` inside where it hits none.
    points: Vec<OnceLock<Option<Point>>>,
    depth: &'a [DepthMap],
    /// What the depth values mean.
    pub kind: DepthKind,
    /// Observed depth per model unit, from frame 0, where the model is in its rest pose.
    slope: f64,
    diagonal: f64,
}

impl<'a> Given<'a> {
    /// Takes the cues; `first` is the rest pose drawn as frame 0 shows it.
    pub fn new(
        tracks: Option<&'a Tracks>,
        depth: &'a [DepthMap],
        kind: DepthKind,
        subject: &Subject,
        camera: &Camera,
        first: &Sight,
    ) -> Self {
        let tracks = tracks.filter(|t| !t.query_frame.is_empty());
        let points = (0..tracks.map_or(0, |t| t.query_frame.len())).map(|_| OnceLock::new()).collect();
        let slope = depth.first().map_or(0.0, |map| depth_slope(map, first));
        // Without a slope there is nothing to be learnt from the values.
        let depth = if slope == 0.0 { &[] } else { depth };
        let given = Self { tracks, points, depth, kind, slope, diagonal: subject.diagonal };
        given.anchor(subject, camera, first, 0);
        given
    }

    /// Whether a track starts in a frame.
    pub fn starts_in(&self, frame: usize) -> bool {
        self.tracks.is_some_and(|t| t.query_frame.iter().any(|&q| q as usize == frame))
    }

    /// Binds the tracks that start in a frame to the surface points seen there.
    pub fn anchor(&self, subject: &Subject, camera: &Camera, sight: &Sight, frame: usize) {
        let Some(tracks) = self.tracks else { return };
        for (i, slot) in self.points.iter().enumerate().filter(|(i, _)| tracks.query_frame[*i] as usize == frame) {
            let [x, y] = tracks.pixels[frame][i].map(f64::from);
            let seen = tracks.confidence[frame][i] > 0.0;
            slot.get_or_init(|| surface_point(subject, camera, sight, DVec2::new(x, y)).filter(|_| seen));
        }
    }

    /// Adds the tracks of a frame; whether there are so many that no flow is needed.
    pub fn add_tracks(&self, subject: &Subject, frame: usize, out: &mut Correspondences) -> bool {
        let Some(tracks) = self.tracks else { return false };
        for (i, slot) in self.points.iter().enumerate() {
            let weight = f64::from(tracks.confidence[frame][i]);
            if let Some(point) = slot.get().and_then(Option::as_ref).filter(|_| weight > 0.0) {
                let pixel = DVec2::from_array(tracks.pixels[frame][i].map(f64::from));
                let anchor = out.push(subject, *point);
                out.tracks.push(PixelTarget { anchor, pixel, weight, normal: None });
            }
        }
        out.tracks.len() >= ENOUGH_POINTS
    }

    /// Adds the depth of every point that a track or flow has placed in a frame.
    pub fn add_depth(&self, camera: &Camera, frame: usize, out: &mut Correspondences) {
        let Some(map) = self.depth.get(frame) else { return };
        let mut last = None;
        for t in out.tracks.iter().chain(&out.flow) {
            // Flow gives up to two targets a point, one after the other.
            if last.replace(t.anchor) == Some(t.anchor) {
                continue;
            }
            let scale =
                DVec2::new(map.width as f64 / f64::from(camera.width), map.height as f64 / f64::from(camera.height));
            if let Some(depth) = sample(map, t.pixel * scale, DEPTH_STEP * self.diagonal * self.slope) {
                out.depth.push(DepthTarget { anchor: t.anchor, depth, weight: t.weight });
            }
        }
    }

    /// Standard deviation of the observed depth, in its own unit.
    pub fn depth_sigma(&self) -> f64 {
        DEPTH_SIGMA * self.diagonal * self.slope
    }
}

/// The surface point exactly at a picture position, or `None` on the background and beside occlusion edges, where a small error
/// of the position would pick another surface.
fn surface_point(subject: &Subject, camera: &Camera, sight: &Sight, at: DVec2) -> Option<Point> {
    let raster = &sight.raster;
    let (x, y) = (at.x as usize, at.y as usize);
    if at.min_element() < 0.0 || x >= raster.width || y >= raster.height || near_edge(subject, sight, x, y) {
        return None;
    }
    let pixel = y * raster.width + x;
    let corners = subject.surface.triangles[raster.triangle[pixel] as usize];
    let [a, b, c] = corners.map(|v| camera.to_view(sight.surface[v as usize]));
    // Weights of the corners at which the ray through the pixel meets their plane.
    let ray = DVec3::new((at.x - camera.cx) / camera.fx, (at.y - camera.cy) / camera.fy, 1.0);
    let weights = DMat3::from_cols(a, b, c).inverse() * ray;
    let weights = weights / weights.element_sum();
    let inside = weights.is_finite() && weights.min_element() > -OVERHANG && weights.max_element() < 1.0 + OVERHANG;
    let weights = if inside { weights.to_array() } else { raster.weights(pixel).map(f64::from) };
    Some(Point { corners, weights })
}

/// |cov(d, z) / var z| over the pixels that the model covers in frame 0; 0 where that says nothing.
fn depth_slope(map: &DepthMap, first: &Sight) -> f64 {
    let raster = &first.raster;
    let pairs: Vec<(f64, f64)> = (0..raster.width * raster.height)
        .filter_map(|p| {
            let (x, y) = (p % raster.width * map.width / raster.width, p / raster.width * map.height / raster.height);
            let d = f64::from(map.values[y * map.width + x]);
            raster.depth(p).filter(|_| d.is_finite()).map(|z| (z, d))
        })
        .collect();
    let n = pairs.len().max(1) as f64;
    let (mz, md) = (pairs.iter().map(|p| p.0).sum::<f64>() / n, pairs.iter().map(|p| p.1).sum::<f64>() / n);
    let covariance: f64 = pairs.iter().map(|(z, d)| (z - mz) * (d - md)).sum();
    let variance: f64 = pairs.iter().map(|(z, _)| (z - mz).powi(2)).sum();
    let slope = (covariance / variance).abs();
    if slope.is_finite() { slope } else { 0.0 }
}

/// Bilinear value at a position; `None` where a neighbour is missing or across a step.
fn sample(map: &DepthMap, at: DVec2, step: f64) -> Option<f64> {
    let p = (at - 0.5).clamp(DVec2::ZERO, DVec2::new(map.width as f64 - 1.0, map.height as f64 - 1.0));
    let (x0, y0) = (p.x as usize, p.y as usize);
    let (x1, y1) = ((x0 + 1).min(map.width - 1), (y0 + 1).min(map.height - 1));
    let v = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)].map(|(x, y)| f64::from(map.values[y * map.width + x]));
    let (low, high) = v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &d| (l.min(d), h.max(d)));
    if v.iter().any(|d| !d.is_finite()) || high - low > step {
        return None;
    }
    let (fx, fy) = (p.x - x0 as f64, p.y - y0 as f64);
    let mix = |a: f64, b: f64, f: f64| a + (b - a) * f;
    Some(mix(mix(v[0], v[1], fx), mix(v[2], v[3], fx), fy))
}

#[cfg(test)]
mod tests {
    use super::super::{Forgetful, Input, Settings, fit};
    use super::*;
    use crate::fixtures::{asset, camera, truth};
    use animimic_render::Light;
    use animimic_rig::Anchor;
    use animimic_scene::{Image, Mask};
    use std::ops::ControlFlow;

    const FRAMES: usize = 6;

    /// Exact depth of a drawing, times and plus something; as 1/z if `kind` says so.
    fn depth_map(sight: &Sight, kind: DepthKind) -> DepthMap {
        let raster = &sight.raster;
        let value = |p: usize| {
            raster.depth(p).map_or(f32::NAN, |z| match kind {
                DepthKind::Metric => (0.37 * z + 0.2) as f32,
                DepthKind::Inverse => (4.0 / z + 0.1) as f32,
            })
        };
        DepthMap {
            width: raster.width,
            height: raster.height,
            values: (0..raster.width * raster.height).map(value).collect(),
        }
    }

    /// Mean vertex error [% of the rest diagonal] of a fit to exact tracks, and to exact depth if asked for, with a blank video.
    fn error_pct(kind: Option<DepthKind>) -> f64 {
        let asset = asset();
        let subject = Subject::new(&asset).expect("can be drawn");
        let camera = camera(320);
        let light = Light::ambient(1.0);
        let studio = super::super::sight::Studio { camera: &camera, light: &light };
        let blank = Image::filled(320, 320, [90; 3]);
        let truth = truth(&subject, FRAMES);
        let sights: Vec<Sight> = truth.iter().map(|p| Sight::draw(&subject, &studio, &blank, p)).collect();
        let masks: Vec<Mask> = sights.iter().map(|s| s.raster.mask()).collect();
        let points: Vec<Anchor> = (0..320 * 320)
            .step_by(37)
            .filter(|&p| sights[0].raster.covered(p) && !near_edge(&subject, &sights[0], p % 320, p / 320))
            .map(|p| sights[0].anchor(&subject, p))
            .collect();
        let place = |s: &Sight| -> Vec<[f32; 2]> {
            points.iter().map(|a| camera.project(a.position(&s.posed)).to_array().map(|v| v as f32)).collect()
        };
        // A point is seen where nothing is drawn in front of it.
        let seen = |s: &Sight, a: &Anchor| {
            let x = a.position(&s.posed);
            let at = camera.project(x);
            let front = s.raster.depth(at.y as usize * 320 + at.x as usize);
            f32::from(front.is_some_and(|z| camera.to_view(x).z < z + DEPTH_STEP * subject.diagonal))
        };
        let tracks = Tracks {
            pixels: sights.iter().map(place).collect(),
            confidence: sights.iter().map(|s| points.iter().map(|a| seen(s, a)).collect()).collect(),
            query_frame: vec![0; points.len()],
        };
        let depth: Vec<DepthMap> = kind.map_or(Vec::new(), |k| sights.iter().map(|s| depth_map(s, k)).collect());
        let frames = vec![blank.clone(); FRAMES];
        let flow = |a: &Image, _: &Image| vec![[0.0; 2]; a.width * a.height];
        let input = Input {
            asset: &asset,
            camera: &camera,
            frames: &frames,
            masks: &masks,
            backgrounds: std::slice::from_ref(&blank),
            flow: &flow,
            tracks: Some(&tracks),
            depth: &depth,
            depth_kind: kind.unwrap_or_default(),
        };
        let found =
            fit(&input, Settings::default(), "clip", 24.0, &mut Forgetful, &mut |_, _| ControlFlow::Continue(()))
                .expect("fits");
        let last = subject.posed(&found.frames[FRAMES - 1]);
        let error: f64 =
            points.iter().map(|a| a.position(&last).distance(a.position(&sights[FRAMES - 1].posed))).sum::<f64>();
        100.0 * error / points.len() as f64 / subject.diagonal
    }

    #[test]
    fn exact_tracks_and_depth_bring_the_motion_back() {
        let without = error_pct(None);
        for kind in [DepthKind::Metric, DepthKind::Inverse] {
            let with = error_pct(Some(kind));
            println!("{kind:?}: {with:.3} % of the diagonal; {without:.3} % without depth");
            assert!(with < 0.3 && with < without);
        }
    }

    #[test]
    fn depth_is_read_between_pixels_and_not_across_steps_or_holes() {
        let map = |values: [f32; 4]| DepthMap { width: 2, height: 2, values: values.into() };
        assert_eq!(sample(&map([1.0, 2.0, 3.0, 4.0]), DVec2::new(1.0, 1.0), 9.0), Some(2.5));
        assert_eq!(sample(&map([1.0, 2.0, 3.0, 4.0]), DVec2::new(1.0, 1.0), 2.0), None);
        assert_eq!(sample(&map([1.0, f32::NAN, 3.0, 4.0]), DVec2::new(1.0, 1.0), 9.0), None);
    }
}

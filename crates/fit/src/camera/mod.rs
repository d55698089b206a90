//! The camera that shows the model, at rest, as it stands in frame 0.
//!
//! 1. `search`: silhouettes over fields of view × azimuths × elevations at low resolution; distance and shift in closed form.
//! 2. `refine`: seven parameters (rotation, translation, focal length) by Levenberg–Marquardt, first on silhouettes alone.
//! 3. `judge`: what silhouettes leave open (front or back, left or right) is decided by appearance under the best light.
//! 4. The best few are refined again, with dense flow from rendering to frame as well, and judged again.
//!
//! Lens distortion and a principal point off the picture's centre are deliberately absent: generated videos have neither.

mod judge;
mod refine;
mod search;

use crate::FitError;
use crate::stage1::contour::Contour;
use crate::stage1::correspond::Flow;
use animimic_render::Surface;
use animimic_scene::{Asset, Camera, Image, Mask};
use glam::DVec3;
use rayon::prelude::*;

/// Where the model is looked for.
#[derive(Clone, Copy)]
pub struct CameraSearch<'a> {
    /// The model; its rest pose is what frame 0 shows.
    pub asset: &'a Asset,
    /// Frame 0.
    pub frame: &'a Image,
    /// The object in frame 0.
    pub mask: &'a Mask,
    /// What is behind the object.
    pub background: &'a Image,
    /// Dense flow between two pictures.
    pub flow: &'a Flow<'a>,
}

/// A camera with how well it explains frame 0.
#[derive(Clone, Copy, Debug)]
pub struct CameraFit {
    /// The camera, at the size of frame 0.
    pub camera: Camera,
    /// Intersection over union of the model's silhouette and the mask.
    pub iou: f64,
    /// How unlike frame 0 the model looks under the best light, in [0, 1]; see `judge`.
    pub unlikeness: f64,
    /// The same for the best camera that looks from a clearly different direction; close to `unlikeness` means a guess.
    pub runner_up: Option<f64>,
}

/// Below this overlap the camera is not the video's.
pub const SMALLEST_IOU: f64 = 0.8;
/// Masks smaller than this say nothing about a camera [px].
const SMALLEST_MASK: usize = 64;
/// Views of the coarse search that are refined on silhouettes.
const CANDIDATES: usize = 16;
/// Of those, how many are refined with flow.
const FINALISTS: usize = 4;
/// Views closer than this are the same view [rad].
const SAME_VIEW_RAD: f64 = 0.35;
/// Longer side of the picture in which candidates are compared [px].
const MIDDLE_SIZE: u32 = 192;

/// The model and the frame, prepared once.
struct Scene<'a> {
    surface: &'a Surface,
    positions: &'a [DVec3],
    frame: &'a Image,
    mask: &'a Mask,
    background: &'a Image,
    flow: &'a Flow<'a>,
    contour: Contour,
    /// Centre and radius of the model's bounding sphere.
    center: DVec3,
    radius: f64,
}

/// Finds the camera of a video's first frame.
///
/// # Errors
/// [`FitError::Input`] when sizes differ, the mask is empty, or no camera reaches [`SMALLEST_IOU`];
/// [`FitError::Render`] when the model cannot be drawn.
pub fn find_camera(input: &CameraSearch) -> Result<CameraFit, FitError> {
    check(input)?;
    let surface = Surface::new(&input.asset.mesh, &input.asset.looks)?;
    let (low, high) = input.asset.mesh.bounds();
    let center = 0.5 * (low + high);
    let positions = &input.asset.mesh.positions;
    let radius = positions.iter().map(|p| p.distance(center)).fold(0.0, f64::max);
    let scene = |frame, mask, background| Scene {
        surface: &surface,
        positions,
        frame,
        mask,
        background,
        flow: input.flow,
        contour: Contour::new(mask),
        center,
        radius,
    };
    let full = scene(input.frame, input.mask, input.background);
    let (frame, mask, background) = (shrunk(input.frame), shrunk_mask(input.mask), shrunk(input.background));
    let middle = scene(&frame, &mask, &background);

    let coarse = search::views(&middle);
    let mut candidates: Vec<(Camera, f64)> = coarse
        .into_par_iter()
        .take(CANDIDATES)
        .map(|camera| {
            let camera = refine::by_silhouette(&middle, &camera);
            (camera, judge::verdict(&middle, &camera).total())
        })
        .collect();
    candidates.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut finalists: Vec<(Camera, judge::Verdict)> = distinct(&candidates)
        .into_par_iter()
        .map(|camera| {
            let camera = refine::with_flow(&full, &camera.resized(full.frame.width as u32, full.frame.height as u32));
            (camera, judge::verdict(&full, &camera))
        })
        .collect();
    finalists.sort_by(|a, b| a.1.total().total_cmp(&b.1.total()));
    let Some(&(camera, best)) = finalists.first() else {
        return Err(FitError::Input("the model has no extent to look at".into()));
    };
    if best.iou < SMALLEST_IOU {
        return Err(FitError::Input(format!(
            "no camera shows the model as in the first frame (best overlap {:.2} of {SMALLEST_IOU} needed): give --camera FILE or \
             preset:NAME, or begin the video with the model's rest pose",
            (100.0 * best.iou).floor() / 100.0
        )));
    }
    let runner_up = finalists.iter().find(|f| view_angle(&f.0, &camera) > SAME_VIEW_RAD).map(|f| f.1.total());
    Ok(CameraFit { camera, iou: best.iou, unlikeness: best.total(), runner_up })
}

fn check(input: &CameraSearch) -> Result<(), FitError> {
    let size = (input.frame.width, input.frame.height);
    if (input.mask.width, input.mask.height) != size || (input.background.width, input.background.height) != size {
        return Err(FitError::Input("the first frame, its mask and its background differ in size".into()));
    }
    if input.mask.area() < SMALLEST_MASK {
        return Err(FitError::Input(
            "no object was found in the first frame to fit the camera to: give --camera FILE or preset:NAME".into(),
        ));
    }
    Ok(())
}

/// The best candidates that look from different directions.
fn distinct(sorted: &[(Camera, f64)]) -> Vec<Camera> {
    let mut kept: Vec<Camera> = Vec::new();
    for (camera, _) in sorted {
        if kept.len() < FINALISTS && kept.iter().all(|k| view_angle(k, camera) > SAME_VIEW_RAD) {
            kept.push(*camera);
        }
    }
    kept
}

/// Angle between the directions in which two cameras look [rad].
fn view_angle(a: &Camera, b: &Camera) -> f64 {
    a.view_from_world.matrix3.row(2).angle_between(b.view_from_world.matrix3.row(2))
}

/// Size and shrinking factor of the middle pictures.
fn middle_size(width: usize, height: usize) -> (usize, usize) {
    let scale = (f64::from(MIDDLE_SIZE) / width.max(height) as f64).min(1.0);
    (((width as f64 * scale).round() as usize).max(1), ((height as f64 * scale).round() as usize).max(1))
}

/// Area averages over the cells of the middle picture.
fn shrunk_values<const N: usize>(width: usize, height: usize, value: impl Fn(usize) -> [u8; N]) -> Vec<[u8; N]> {
    let (w, h) = middle_size(width, height);
    let span = |i: usize, n: usize, m: usize| (i * m / n, ((i + 1) * m / n).max(i * m / n + 1).min(m));
    (0..w * h)
        .map(|i| {
            let ((x0, x1), (y0, y1)) = (span(i % w, w, width), span(i / w, h, height));
            let mut sum = [0usize; N];
            for y in y0..y1 {
                for x in x0..x1 {
                    value(y * width + x).iter().zip(&mut sum).for_each(|(v, s)| *s += usize::from(*v));
                }
            }
            let n = (x1 - x0) * (y1 - y0);
            sum.map(|s| ((s + n / 2) / n) as u8)
        })
        .collect()
}

fn shrunk(image: &Image) -> Image {
    let (width, height) = middle_size(image.width, image.height);
    Image { width, height, rgb: shrunk_values(image.width, image.height, |i| image.rgb[i]) }
}

fn shrunk_mask(mask: &Mask) -> Mask {
    let (width, height) = middle_size(mask.width, mask.height);
    let coverage = shrunk_values(mask.width, mask.height, |i| [mask.coverage[i]]);
    Mask { width, height, coverage: coverage.into_iter().flatten().collect() }
}

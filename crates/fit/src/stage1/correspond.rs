//! Where the surface points that a rendering shows are in a frame of the video.

use super::contour::Contour;
use super::sight::{Point, Sight};
use super::subject::Subject;
use crate::color::{color_distance, luma};
use crate::terms::{DepthTarget, PixelTarget};
use animimic_render::NONE;
use animimic_rig::Anchor;
use animimic_scene::image::bounds;
use animimic_scene::{Image, Mask};
use glam::DVec2;

/// Dense flow from one picture to another of the same size: a displacement [px] per pixel.
pub type Flow<'a> = dyn Fn(&Image, &Image) -> Vec<[f32; 2]> + Sync + 'a;

/// One frame of the video with what was derived from it once.
pub struct Frame<'a> {
    /// Pixels.
    pub image: &'a Image,
    /// Object coverage.
    pub mask: &'a Mask,
    /// Contour of the mask.
    pub contour: Contour,
    /// What is behind the object.
    pub background: &'a Image,
}

/// Anchors made from a rendering, with their targets in a frame.
#[derive(Clone, Debug, Default)]
pub struct Correspondences {
    /// Surface points.
    pub points: Vec<Point>,
    /// The same as they move with the skin.
    pub anchors: Vec<Anchor>,
    /// From appearance; `anchor` indexes `anchors`.
    pub flow: Vec<PixelTarget>,
    /// From silhouettes.
    pub contour: Vec<PixelTarget>,
    /// From given tracks.
    pub tracks: Vec<PixelTarget>,
    /// From given depth.
    pub depth: Vec<DepthTarget>,
}

impl Correspondences {
    /// Adds a surface point; returns its index.
    pub(super) fn push(&mut self, subject: &Subject, point: Point) -> u32 {
        self.anchors.push(point.anchor(subject));
        self.points.push(point);
        self.points.len() as u32 - 1
    }
}

/// Surface points wanted per rendering.
const POINTS: usize = 700;
/// Contour points wanted per rendering and direction.
const CONTOUR_POINTS: usize = 250;
/// Colour difference at which a flow target's weight has dropped to 1/e [8-bit levels].
const COLOR_SIGMA: f64 = 30.0;
/// Structure (summed squared slope of luma in a 5×5 window) at which a direction counts half.
const TEXTURE_HALF: f64 = 2500.0;
/// Depth step between neighbours that makes an occlusion edge [rest diagonal].
pub(super) const DEPTH_STEP: f64 = 0.02;
/// Distance to an occlusion edge below which flow is not trusted [px].
const EDGE_MARGIN: isize = 2;
/// Margin around the object when pictures are cut out for the flow [px].
const CROP_MARGIN: usize = 24;

/// Dense flow from a rendering to a frame, around the object.
pub struct FlowAround {
    window: Window,
    vectors: Vec<[f32; 2]>,
}

impl FlowAround {
    /// Nothing where neither rendering nor frame shows the object.
    pub fn new(sight: &Sight, frame: &Frame, flow: &Flow) -> Option<Self> {
        let window = Window::around(sight, frame.mask)?;
        let vectors = flow(&window.cut(&sight.image), &window.cut(frame.image));
        Some(Self { window, vectors })
    }
}

/// Appearance correspondences: flow from the rendering to the frame at a grid of visible surface points.
pub fn by_flow(subject: &Subject, sight: &Sight, frame: &Frame, found: Option<FlowAround>, out: &mut Correspondences) {
    let raster = &sight.raster;
    let (w, h) = (raster.width, raster.height);
    let Some(FlowAround { window, vectors }) = found else { return };
    let covered = raster.triangle.iter().filter(|&&t| t != NONE).count();
    let stride = ((covered as f64 / POINTS as f64).sqrt().round() as usize).max(1);
    for y in (stride / 2..h).step_by(stride) {
        for x in (stride / 2..w).step_by(stride) {
            let pixel = y * w + x;
            if raster.triangle[pixel] == NONE || near_edge(subject, sight, x, y) {
                continue;
            }
            let v = vectors[(y - window.y0) * window.width + (x - window.x0)];
            let from = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let to = from + DVec2::new(f64::from(v[0]), f64::from(v[1]));
            let (tx, ty) = (to.x as isize, to.y as isize);
            if tx < 1 || ty < 1 || tx as usize + 1 >= w || ty as usize + 1 >= h {
                continue;
            }
            let target = ty as usize * w + tx as usize;
            if frame.mask.coverage[target] < 128 {
                continue;
            }
            let difference = color_distance(sight.image.rgb[pixel], frame.image.rgb[target]);
            let weight = (-(difference / COLOR_SIGMA).powi(2)).exp();
            let index = out.anchors.len() as u32;
            let mut used = false;
            for (axis, strength) in structure(&sight.image, x, y) {
                let weight = weight * strength / (strength + TEXTURE_HALF);
                if weight > 0.02 {
                    out.flow.push(PixelTarget { anchor: index, pixel: to, weight, normal: Some(axis) });
                    used = true;
                }
            }
            if used {
                out.push(subject, sight.point(subject, pixel));
            }
        }
    }
}

/// Silhouette correspondences within `reach` pixels, from the rendered to the observed contour and back. `bias` is how far the
/// observed contour lies outside the `rendered` one when both show the same [px].
pub fn by_contour(
    subject: &Subject,
    (sight, rendered): (&Sight, &Contour),
    frame: &Frame,
    reach: f64,
    bias: f64,
    out: &mut Correspondences,
) {
    for (r, o) in rendered.pairs(&frame.contour, reach, CONTOUR_POINTS) {
        let (p, q) = (rendered.points[r], frame.contour.points[o]);
        let pixel = p.y as usize * sight.raster.width + p.x as usize;
        let anchor = out.push(subject, sight.point(subject, pixel));
        let normal = frame.contour.normals[o];
        out.contour.push(PixelTarget { anchor, pixel: q - normal * bias, weight: 1.0, normal: Some(normal) });
    }
}

/// How far a frame's contour lies outside the rendered one [px], as the mean over the contour: thresholds and soft edges
/// shift all of it alike, and a shift that is not taken out would make the model come closer.
pub fn contour_bias(sight: &Sight, frame: &Frame) -> f64 {
    let rendered = Contour::new(&sight.raster.mask());
    let (mut sum, mut count) = (0.0, 0);
    for (r, p) in rendered.points.iter().enumerate() {
        let Some(o) = frame.contour.nearest(*p) else { continue };
        if rendered.matches(r, &frame.contour, o, BIAS_REACH) {
            // Gaps are whole pixels: their median would be too.
            sum += frame.contour.normals[o].dot(frame.contour.points[o] - *p);
            count += 1;
        }
    }
    sum / f64::from(count.max(1))
}

/// Contours farther apart than this are not the same edge [px].
const BIAS_REACH: f64 = 2.5;

/// The part of the picture around rendered and observed object.
struct Window {
    x0: usize,
    y0: usize,
    width: usize,
    height: usize,
}

impl Window {
    fn around(sight: &Sight, mask: &Mask) -> Option<Self> {
        let (w, h) = (mask.width, mask.height);
        let shown = |x: usize, y: usize| sight.raster.triangle[y * w + x] != NONE || mask.inside(x, y);
        let [columns, rows] = bounds(w, h, shown)?;
        let (x0, y0) = (columns.start.saturating_sub(CROP_MARGIN), rows.start.saturating_sub(CROP_MARGIN));
        let (x1, y1) = ((columns.end + CROP_MARGIN).min(w), (rows.end + CROP_MARGIN).min(h));
        Some(Self { x0, y0, width: x1 - x0, height: y1 - y0 })
    }

    fn cut(&self, image: &Image) -> Image {
        image.cropped(self.x0..self.x0 + self.width, self.y0..self.y0 + self.height)
    }
}

/// Whether background or another surface is within the margin.
pub(super) fn near_edge(subject: &Subject, sight: &Sight, x: usize, y: usize) -> bool {
    let raster = &sight.raster;
    let Some(depth) = raster.depth(y * raster.width + x) else { return true };
    for dy in [-EDGE_MARGIN, 0, EDGE_MARGIN] {
        for dx in [-EDGE_MARGIN, 0, EDGE_MARGIN] {
            let (px, py) = (x as isize + dx, y as isize + dy);
            if px < 0 || py < 0 || px as usize >= raster.width || py as usize >= raster.height {
                return true;
            }
            match raster.depth(py as usize * raster.width + px as usize) {
                Some(d) if (d - depth).abs() < DEPTH_STEP * subject.diagonal => {}
                _ => return true,
            }
        }
    }
    false
}

/// Eigenvectors and eigenvalues of the structure tensor of luma in a 5×5 window.
fn structure(image: &Image, x: usize, y: usize) -> [(DVec2, f64); 2] {
    let luma = |x: usize, y: usize| luma(image.at(x, y).map(f64::from));
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for py in y.saturating_sub(2).max(1)..(y + 3).min(image.height - 1) {
        for px in x.saturating_sub(2).max(1)..(x + 3).min(image.width - 1) {
            let gx = 0.5 * (luma(px + 1, py) - luma(px - 1, py));
            let gy = 0.5 * (luma(px, py + 1) - luma(px, py - 1));
            (xx, xy, yy) = (xx + gx * gx, xy + gx * gy, yy + gy * gy);
        }
    }
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    let root = half.hypot(xy);
    let angle = 0.5 * xy.atan2(half);
    let major = DVec2::from_angle(angle);
    [(major, mean + root), (major.perp(), (mean - root).max(0.0))]
}

//! Per-triangle preparation for the rasteriser: culling, near cut, edge functions, the depth plane.

use crate::clip::clip_near;
use crate::project::ScreenPoint;
use crate::raster::{Cutout, Facing};
use animimic_scene::Camera;
use glam::DVec3;

/// Vertices nearer than this fraction of the farthest vertex's depth are cut off: the only near plane there is.
const NEAR_FRACTION: f64 = 1e-4;

/// What is drawn, from where, and how.
pub(crate) struct Geometry<'a> {
    pub camera: &'a Camera,
    pub positions: &'a [DVec3],
    pub screen: &'a [ScreenPoint],
    pub triangles: &'a [[u32; 3]],
    pub facing: Facing<'a>,
    pub cutout: Option<Cutout<'a>>,
    pub width: usize,
    pub height: usize,
}

/// One edge, oriented so that the triangle is where e ≥ `least`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Edge {
    pub x: f32,
    pub y: f32,
    pub dx: f32,
    pub dy: f32,
    pub least: f32,
}

/// All that the inner loop needs of a triangle (or of a piece of one cut at the near plane).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Setup {
    pub edges: [Edge; 3],
    /// 1/z = q + qx (x − x0) + qy (y − y0), kept within the vertices' range because slivers extrapolate badly.
    pub x0: f32,
    pub y0: f32,
    pub q: f32,
    pub qx: f32,
    pub qy: f32,
    pub q_range: [f32; 2],
    pub columns: [u32; 2],
    pub rows: [u32; 2],
    pub triangle: u32,
}

/// Hands every triangle that may cover a pixel to `emit`, in order, cut at the near plane where it must be.
pub(crate) fn setup_all(g: &Geometry, emit: &mut dyn FnMut(&Setup)) {
    let least_q = g.screen.iter().map(|s| s.q).filter(|&q| q > 0.0).fold(f64::INFINITY, f64::min);
    if !least_q.is_finite() {
        return;
    }
    let largest_q = least_q / NEAR_FRACTION;
    for (index, corners) in g.triangles.iter().enumerate() {
        if corners.iter().any(|&c| c as usize >= g.screen.len()) {
            continue;
        }
        let p = [g.screen[corners[0] as usize], g.screen[corners[1] as usize], g.screen[corners[2] as usize]];
        let cull = g.facing.cull_back.get(index).copied().unwrap_or(false);
        if p.iter().all(|p| p.q > 0.0 && p.q <= largest_q) {
            if let Some(s) = setup(p, cull, index as u32, g.width, g.height) {
                emit(&s);
            }
        } else if p.iter().any(|p| p.q > 0.0) {
            let view = corners.map(|c| g.camera.to_view(g.positions[c as usize]));
            let cut = clip_near(&view, 1.0 / largest_q);
            for k in 2..cut.len() {
                let piece = [cut[0], cut[k - 1], cut[k]].map(|v| {
                    let pixel = g.camera.pixel_from_view(v);
                    ScreenPoint { x: pixel.x, y: pixel.y, q: 1.0 / v.z }
                });
                if let Some(s) = setup(piece, cull, index as u32, g.width, g.height) {
                    emit(&s);
                }
            }
        }
    }
}

#[inline]
fn setup(p: [ScreenPoint; 3], cull: bool, triangle: u32, width: usize, height: usize) -> Option<Setup> {
    let x = [p[0].x as f32, p[1].x as f32, p[2].x as f32];
    let y = [p[0].y as f32, p[1].y as f32, p[2].y as f32];
    // Most triangles of a fine mesh lie between pixel centres: found out first.
    let columns = pixel_range(x, width)?;
    let rows = pixel_range(y, height)?;
    let area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
    // Front faces are counter-clockwise in the world, hence negative with y downwards. NaN fails every comparison below.
    if !(area.is_finite() && area != 0.0) || (cull && area > 0.0) {
        return None;
    }
    let q = [p[0].q as f32, p[1].q as f32, p[2].q as f32];
    let inv = 1.0 / area;
    let (q1, q2) = (q[1] - q[0], q[2] - q[0]);
    Some(Setup {
        edges: [
            edge([x[0], y[0]], [x[1], y[1]], area > 0.0),
            edge([x[1], y[1]], [x[2], y[2]], area > 0.0),
            edge([x[2], y[2]], [x[0], y[0]], area > 0.0),
        ],
        x0: x[0],
        y0: y[0],
        q: q[0],
        qx: (q1 * (y[2] - y[0]) - q2 * (y[1] - y[0])) * inv,
        qy: (q2 * (x[1] - x[0]) - q1 * (x[2] - x[0])) * inv,
        q_range: [q[0].min(q[1]).min(q[2]), q[0].max(q[1]).max(q[2])],
        columns,
        rows,
        triangle,
    })
}

/// Pixels whose centres lie between the least and the largest of three coordinates, within the picture.
#[inline(always)]
fn pixel_range(c: [f32; 3], size: usize) -> Option<[u32; 2]> {
    let lo = c[0].min(c[1]).min(c[2]);
    let hi = c[0].max(c[1]).max(c[2]);
    let first = (lo - 0.5).ceil().max(0.0);
    let end = ((hi - 0.5).floor() + 1.0).min(size as f32);
    (first < end).then_some([first as u32, end as u32])
}

#[inline(always)]
fn edge(a: [f32; 2], b: [f32; 2], positive_area: bool) -> Edge {
    // Upper end first; of two at the same height the right one: then e > 0 is right of the edge, below a horizontal one,
    // which is where the top-left rule includes the edge itself.
    let forward = a[1] < b[1] || (a[1] == b[1] && a[0] > b[0]);
    let (l, h) = if forward { (a, b) } else { (b, a) };
    // Walking a→b with positive area the interior has cross(b − a, p − a) > 0, i.e. e < 0 for l = a.
    let inside_positive = forward != positive_area;
    let sign = if inside_positive { 1.0 } else { -1.0 };
    // The least positive float stands for "> 0".
    let least = if inside_positive { 0.0 } else { f32::from_bits(1) };
    Edge { x: l[0], y: l[1], dx: sign * (h[0] - l[0]), dy: sign * (h[1] - l[1]), least }
}

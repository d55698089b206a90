//! Per-triangle preparation for the rasteriser: culling, near cut, edge functions, the depth plane.

use crate::clip::clip_near;
use crate::project::ScreenPoint;
use crate::raster::{Cutout, Facing};
use animimic_scene::Camera;
use glam::DVec3;
use wide::f32x4;

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

/// A screen point in single precision: x, y, 1/z, and 1 where it cannot be drawn as it is (behind the camera or too near), else 0.
type Corner = [f32; 4];

/// A triangle (or a piece of one cut at the near plane) with the pixels it may cover.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub corners: [Corner; 3],
    /// Twice the signed area, not zero [px²].
    pub area: f32,
    /// Least and largest 1/z.
    pub q_range: [f32; 2],
    pub columns: [u32; 2],
    pub rows: [u32; 2],
    pub triangle: u32,
}

/// 1/z = q + qx (x − x0) + qy (y − y0), kept within the vertices' range because slivers extrapolate badly.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DepthPlane {
    pub x0: f32,
    pub y0: f32,
    pub q: f32,
    pub qx: f32,
    pub qy: f32,
}

impl Edge {
    /// Whether a position is on the triangle's side.
    #[inline(always)]
    pub fn holds(&self, x: f32, y: f32) -> bool {
        (x - self.x).mul_add(self.dy, -(y - self.y) * self.dx) >= self.least
    }
}

impl DepthPlane {
    /// 1/z at a position, within `range`.
    #[inline(always)]
    pub fn at(&self, x: f32, y: f32, range: [f32; 2]) -> f32 {
        (x - self.x0).mul_add(self.qx, self.q + self.qy * (y - self.y0)).max(range[0]).min(range[1])
    }
}

impl Candidate {
    /// The three edges.
    #[inline(always)]
    pub fn edges(&self) -> [Edge; 3] {
        let [a, b, c] = self.corners.map(|c| [c[0], c[1]]);
        let positive = self.area > 0.0;
        [edge(a, b, positive), edge(b, c, positive), edge(c, a, positive)]
    }

    /// The plane of 1/z.
    #[inline(always)]
    pub fn depth(&self) -> DepthPlane {
        let [[x0, y0, q, _], b, c] = self.corners;
        let inv = 1.0 / self.area;
        let (q1, q2) = (b[2] - q, c[2] - q);
        DepthPlane {
            x0,
            y0,
            q,
            qx: (q1 * (c[1] - y0) - q2 * (b[1] - y0)) * inv,
            qy: (q2 * (b[0] - x0) - q1 * (c[0] - x0)) * inv,
        }
    }
}

/// Hands every triangle that may cover a pixel to `emit`, cut at the near plane where it must be: first those that show their
/// front, then the backs, most of which are then found hidden before anything is computed. Each in the triangles' order.
pub(crate) fn setup_all(g: &Geometry, emit: &mut dyn FnMut(&Candidate)) {
    let least_q = g.screen.iter().map(|s| s.q).filter(|&q| q > 0.0).fold(f64::INFINITY, f64::min);
    if !least_q.is_finite() {
        return;
    }
    let largest_q = least_q / NEAR_FRACTION;
    let points: Vec<Corner> = g
        .screen
        .iter()
        .map(|p| {
            let drawable = p.q > 0.0 && p.q <= largest_q;
            [p.x as f32, p.y as f32, p.q as f32, f32::from(u8::from(!drawable))]
        })
        .collect();
    let size = f32x4::new([g.width as f32, g.height as f32, 0.0, 0.0]);
    let mut backs: Vec<Candidate> = Vec::with_capacity(g.triangles.len() / 2);
    let mut sort = |c: Candidate, cull: bool, backs: &mut Vec<Candidate>| {
        // Front faces are counter-clockwise in the world, hence negative with y downwards.
        if c.area < 0.0 {
            emit(&c);
        } else if !cull {
            backs.push(c);
        }
    };
    for (index, corners) in g.triangles.iter().enumerate() {
        let [a, b, c] = corners.map(|c| points.get(c as usize));
        let (Some(a), Some(b), Some(c)) = (a, b, c) else { continue };
        let cull = || g.facing.cull_back.get(index).copied().unwrap_or(false);
        if a[3] + b[3] + c[3] == 0.0 {
            if let Some(candidate) = candidate([*a, *b, *c], index as u32, size) {
                sort(candidate, cull(), &mut backs);
            }
        } else {
            for piece in cut(g, index, largest_q) {
                if let Some(candidate) = candidate(piece, index as u32, size) {
                    sort(candidate, cull(), &mut backs);
                }
            }
        }
    }
    backs.iter().for_each(emit);
}

/// What remains of a triangle in front of the near plane.
fn cut(g: &Geometry, triangle: usize, largest_q: f64) -> Vec<[Corner; 3]> {
    let corners = g.triangles[triangle].map(|c| c as usize);
    if !corners.iter().any(|&c| g.screen[c].q > 0.0) {
        return Vec::new();
    }
    let cut = clip_near(&corners.map(|c| g.camera.to_view(g.positions[c])), 1.0 / largest_q);
    let corner = |v: DVec3| {
        let pixel = g.camera.pixel_from_view(v);
        [pixel.x as f32, pixel.y as f32, (1.0 / v.z) as f32, 0.0]
    };
    (2..cut.len()).map(|k| [cut[0], cut[k - 1], cut[k]].map(corner)).collect()
}

#[inline(always)]
fn candidate(corners: [Corner; 3], triangle: u32, size: f32x4) -> Option<Candidate> {
    let p = corners.map(f32x4::new);
    let lo = p[0].fast_min(p[1]).fast_min(p[2]);
    let hi = p[0].fast_max(p[1]).fast_max(p[2]);
    // Pixels whose centres lie between the least and the largest coordinates, within the picture. Most triangles of a fine mesh
    // lie between pixel centres: found out first.
    let half = f32x4::splat(0.5);
    let first = (lo - half).ceil().fast_max(f32x4::ZERO).to_array();
    let end = ((hi - half).floor() + f32x4::ONE).fast_min(size).to_array();
    if !(first[0] < end[0] && first[1] < end[1]) {
        return None;
    }
    let [a, b, c] = corners;
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    if !(area.is_finite() && area != 0.0) {
        return None;
    }
    let (lo, hi) = (lo.to_array(), hi.to_array());
    Some(Candidate {
        corners,
        area,
        q_range: [lo[2], hi[2]],
        columns: [first[0] as u32, end[0] as u32],
        rows: [first[1] as u32, end[1] as u32],
        triangle,
    })
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

//! Gradients of visibility: what happens where one pixel shows one triangle and its neighbour another.
//!
//! Micro-edges (after EdgeGrad, Pidhorskyi et al. 2024, eq. 9–12): between neighbouring pixel centres A and B with colours I_A,
//! I_B there is a step; moving it by δ along A→B changes the loss by g·δ, g = ½ Σ_c (∂L/∂I_A + ∂L/∂I_B)(I_A − I_B). The step
//! moves with the surface in front, so g goes to that fragment's screen point, hence to its triangle's corners by the affine
//! weights. Who is in front: with a = \[A's centre lies in triangle B\], b = \[B's centre lies in triangle A\],
//! - only one is a surface: that one;
//! - a and not b: A hides B; b and not a: B hides A;
//! - both: two surfaces cut through each other; the step follows their intersection, which is left out;
//! - neither: one surface continued, or an occlusion between triangles smaller than a pixel. It is an occlusion if the nearer
//!   triangle touches a silhouette or border of its mesh, shares no corner with the other, and the depths, continued along
//!   each triangle's plane, miss each other by more than the planes' slopes.
//!
//! Where the surface continues, colours may still jump (flat facets, hard edges, texture seams). EdgeGrad drops these steps;
//! here the jump, both sides shaded at the middle, goes to both fragments in halves, as the shared edge moves with both. A
//! smooth surface has no jump, and is not asked.

use crate::interpolate::Weights;
use crate::light::Light;
use crate::project::ScreenPoint;
use crate::raster::{NONE, Raster};
use crate::render::{Cotangents, Rendered};
use crate::shade::{Lit, Posed};
use crate::silhouette::silhouette_triangles;
use crate::srgb::Encoder;

/// Adds the edges' ∂L/∂screen points (x and y; depth has no edges).
pub(crate) fn edges_vjp(
    posed: &Posed,
    light: &Light,
    rendered: &Rendered,
    d: &Cotangents,
    d_screen: &mut [ScreenPoint],
) {
    if d.rgb.is_empty() && d.mask.is_empty() {
        return;
    }
    let surface = posed.surface;
    let silhouette = silhouette_triangles(&surface.topology, &surface.triangles, posed.screen);
    let raster = &rendered.raster;
    let mut edges = Edges { posed, light, rendered, d, silhouette, encoder: Encoder::new(), d_screen };
    let w = raster.width;
    for (y, row) in raster.triangle.chunks_exact(w.max(1)).enumerate() {
        for (x, pair) in row.windows(2).enumerate() {
            if pair[0] != pair[1] {
                edges.pair(y * w + x, y * w + x + 1, Axis::X);
            }
        }
        if let Some(below) = raster.triangle.get((y + 1) * w..(y + 2) * w) {
            for (x, (a, b)) in row.iter().zip(below).enumerate() {
                if a != b {
                    edges.pair(y * w + x, (y + 1) * w + x, Axis::Y);
                }
            }
        }
    }
}

#[derive(Clone, Copy)]
enum Axis {
    X,
    Y,
}

/// What a step between two pixels is.
#[derive(Debug, PartialEq)]
enum Step {
    /// The first, or the second, is in front.
    First,
    Second,
    /// One surface, or nothing that can be said.
    Continuous,
    Intersection,
}

struct Edges<'a> {
    posed: &'a Posed<'a>,
    light: &'a Light,
    rendered: &'a Rendered,
    d: &'a Cotangents<'a>,
    silhouette: Vec<bool>,
    encoder: Encoder,
    d_screen: &'a mut [ScreenPoint],
}

impl Edges<'_> {
    fn pair(&mut self, a: usize, b: usize, axis: Axis) {
        let raster = &self.rendered.raster;
        let (ta, tb) = (raster.triangle[a], raster.triangle[b]);
        if ta == NONE || tb == NONE {
            let sign = if ta == NONE { -1.0 } else { 1.0 };
            let mask = if self.d.mask.is_empty() { 0.0 } else { 0.5 * sign * (self.d.mask[a] + self.d.mask[b]) };
            let g = mask + self.color_step(a, b);
            return if ta == NONE { self.scatter(b, axis, -1.0, g) } else { self.scatter(a, axis, 1.0, g) };
        }
        if self.d.rgb.is_empty() {
            return;
        }
        let joined = self.share_corner(ta, tb);
        let step = if joined && !self.silhouette[ta as usize] && !self.silhouette[tb as usize] {
            Step::Continuous
        } else {
            self.classify(a, b, axis, joined)
        };
        match step {
            Step::First => self.scatter(a, axis, 1.0, self.color_step(a, b)),
            Step::Second => self.scatter(b, axis, -1.0, self.color_step(a, b)),
            Step::Continuous => {
                let g = 0.5 * self.jump(a, b, axis);
                self.scatter(a, axis, 1.0, g);
                self.scatter(b, axis, -1.0, g);
            }
            Step::Intersection => {}
        }
    }

    /// ½ Σ_c (∂L/∂I_A + ∂L/∂I_B)(I_A − I_B).
    fn color_step(&self, a: usize, b: usize) -> f32 {
        if self.d.rgb.is_empty() {
            return 0.0;
        }
        let (da, db) = (self.d.rgb[a], self.d.rgb[b]);
        let (ia, ib) = (self.rendered.rgb[a], self.rendered.rgb[b]);
        0.5 * (0..3).map(|c| (da[c] + db[c]) * (ia[c] - ib[c])).sum::<f32>()
    }

    /// The same with the colours that both triangles have in the middle between the pixels; zero where they share smooth
    /// attributes.
    fn jump(&self, a: usize, b: usize, axis: Axis) -> f32 {
        let raster = &self.rendered.raster;
        let (ta, tb) = (raster.triangle[a], raster.triangle[b]);
        let surface = self.posed.surface;
        let corners = surface.triangles[tb as usize];
        let smooth = !surface.normals.is_flat() || surface.look(ta).unlit;
        let shared = surface.triangles[ta as usize].iter().any(|v| corners.contains(v));
        let same_look = surface.look_of_triangle[ta as usize] == surface.look_of_triangle[tb as usize];
        let (da, db) = (self.d.rgb[a], self.d.rgb[b]);
        let sum = [0, 1, 2].map(|c| da[c] + db[c]);
        if (smooth && shared && same_look) || sum == [0.0; 3] {
            return 0.0;
        }
        let (x, y) = centre(raster, a);
        let (x, y) = match axis {
            Axis::X => (x + 0.5, y),
            Axis::Y => (x, y + 0.5),
        };
        match (self.color_at(ta, x, y), self.color_at(tb, x, y)) {
            (Some(ia), Some(ib)) => 0.5 * (0..3).map(|c| sum[c] * (ia[c] - ib[c])).sum::<f32>(),
            _ => 0.0,
        }
    }

    /// Colour of a triangle's plane at a screen position.
    fn color_at(&self, triangle: u32, x: f32, y: f32) -> Option<[f32; 3]> {
        let corners = self.posed.corners(triangle, true);
        let weights = corners.weights.as_ref()?;
        let [b0, b1] = weights.at(x, y);
        let fragment = corners.fragment([b0, b1, 1.0 - b0 - b1], weights.inverse_depth(x, y));
        Some(self.encoder.encode_rgb(Lit::new(self.light, &fragment).linear))
    }

    fn share_corner(&self, ta: u32, tb: u32) -> bool {
        let surface = self.posed.surface;
        let joined = |t: u32| surface.triangles[t as usize].map(|v| surface.topology.joined[v as usize]);
        let other = joined(tb);
        joined(ta).iter().any(|v| other.contains(v))
    }

    fn classify(&self, a: usize, b: usize, axis: Axis, joined: bool) -> Step {
        let raster = &self.rendered.raster;
        let (ta, tb) = (raster.triangle[a], raster.triangle[b]);
        let (pa, pb) = (self.points(ta), self.points(tb));
        let (ca, cb) = (centre(raster, a), centre(raster, b));
        match (contains(&pb, ca), contains(&pa, cb)) {
            (true, false) => Step::First,
            (false, true) => Step::Second,
            (true, true) => Step::Intersection,
            (false, false) if joined => Step::Continuous,
            (false, false) => {
                let (Some(wa), Some(wb)) = (Weights::new(pa), Weights::new(pb)) else { return Step::Continuous };
                let k = match axis {
                    Axis::X => 0,
                    Axis::Y => 1,
                };
                let (qa, qb) = (raster.inv_z[a], raster.inv_z[b]);
                let (sa, sb) = (wa.depth_slope()[k], wb.depth_slope()[k]);
                let gap = (qa + sa - qb).abs().min((qb - sb - qa).abs());
                let nearer = if qa > qb { ta } else { tb };
                if gap <= sa.abs().max(sb.abs()) || !self.silhouette[nearer as usize] {
                    Step::Continuous
                } else if qa > qb {
                    Step::First
                } else {
                    Step::Second
                }
            }
        }
    }

    fn points(&self, triangle: u32) -> [ScreenPoint; 3] {
        self.posed.surface.triangles[triangle as usize].map(|v| self.posed.screen[v as usize])
    }

    /// Adjoint of the place of a step: the point where the line from the centre of `pixel`, which shows the surface in front,
    /// towards its neighbour (`toward` = ±1 along the axis) leaves the triangle, at most at the neighbour's centre.
    fn scatter(&mut self, pixel: usize, axis: Axis, toward: f64, g: f32) {
        if g == 0.0 {
            return;
        }
        let raster = &self.rendered.raster;
        let triangle = raster.triangle[pixel];
        let p = self.points(triangle);
        let Some(lambda) = affine_at_exit(&p, centre(raster, pixel), axis, toward) else { return };
        let corners = self.posed.surface.triangles[triangle as usize];
        for (v, l) in corners.into_iter().zip(lambda) {
            let d = &mut self.d_screen[v as usize];
            match axis {
                Axis::X => d.x += l * f64::from(g),
                Axis::Y => d.y += l * f64::from(g),
            }
        }
    }
}

/// Affine weights where a step leaves a triangle; `None` for triangles that are edge-on or reach behind the camera.
fn affine_at_exit(p: &[ScreenPoint; 3], (x, y): (f32, f32), axis: Axis, toward: f64) -> Option<[f64; 3]> {
    let (ax, ay, bx, by) = (p[0].x - p[2].x, p[0].y - p[2].y, p[1].x - p[2].x, p[1].y - p[2].y);
    let inv = 1.0 / (ax * by - bx * ay);
    if !inv.is_finite() || p.iter().any(|p| p.q <= 0.0) {
        return None;
    }
    let (dx, dy) = (f64::from(x) - p[2].x, f64::from(y) - p[2].y);
    let (l0, l1) = ((dx * by - dy * bx) * inv, (dy * ax - dx * ay) * inv);
    let (s0, s1) = match axis {
        Axis::X => (by * inv * toward, -ay * inv * toward),
        Axis::Y => (-bx * inv * toward, ax * inv * toward),
    };
    let (l, s) = ([l0, l1, 1.0 - l0 - l1], [s0, s1, -s0 - s1]);
    let exit = (0..3).filter(|&i| s[i] < 0.0).map(|i| (l[i] / -s[i]).max(0.0)).fold(1.0, f64::min);
    Some([0, 1, 2].map(|i| l[i] + exit * s[i]))
}

fn centre(raster: &Raster, pixel: usize) -> (f32, f32) {
    ((pixel % raster.width) as f32 + 0.5, (pixel / raster.width) as f32 + 0.5)
}

fn contains(p: &[ScreenPoint; 3], (x, y): (f32, f32)) -> bool {
    let (x, y) = (f64::from(x), f64::from(y));
    let e = [0, 1, 2].map(|k| {
        let (a, b) = (p[k], p[(k + 1) % 3]);
        (x - a.x) * (b.y - a.y) - (y - a.y) * (b.x - a.x)
    });
    p.iter().all(|p| p.q > 0.0) && (e.iter().all(|&e| e >= 0.0) || e.iter().all(|&e| e <= 0.0))
}

//! Gradients of visibility: what happens where one pixel shows one triangle and its neighbour another.
//!
//! Micro-edges (after EdgeGrad, Pidhorskyi et al. 2024, eq. 9–12): between neighbouring pixel centres A and B with colours I_A,
//! I_B there is a step; moving it by δ along A→B changes the loss by g·δ, g = ½ Σ_c (∂L/∂I_A + ∂L/∂I_B)(I_A − I_B). The step moves with the surface in front, so g goes to a point of it. Who is in front: with a = \[A's centre lies in triangle B\],
//! b = \[B's centre lies in triangle A\],
//! - only one is a surface: that one;
//! - a and not b: A hides B; b and not a: B hides A;
//! - both: two surfaces cut through each other; the step follows their intersection, which is left out;
//! - neither: one surface continued, or an occlusion between triangles smaller than a pixel. It is an occlusion if a
//!   silhouette with the nearer pixel on its inner side crosses between the two, before what the farther pixel shows. (A gap in
//!   depth beyond the planes' slopes, the usual test, takes steep continuous surfaces for occlusions and the reverse.)
//!
//! EdgeGrad takes the colours and the moving point at the pixel centres. On a curved surface a pixel inside its outline
//! the point, its normal and its velocity are already different ones (26° on a ball of 20 pixels), a bias that supersampled
//! differences show. Here the silhouette edge itself is cut with the line AB ([`crate::silhouette`]): its
//! ends carry the gradient, its colour is I in front. Without a crossing (cutouts) the step is taken where AB leaves the triangle.
//! Where several edges cross AB (slits and limbs thinner than a pixel), neither colour need be what lies beside an edge: each is
//! looked past alone, and those that are seen make a step each (`between.rs`).
//!
//! Where the surface continues, colours may still jump (flat facets, hard edges, texture seams). EdgeGrad drops these steps;
//! here the jump, both sides shaded at the middle, goes to both fragments in halves, as the shared edge moves with both. A
//! smooth surface has no jump, and is not asked.

use crate::between::{Between, Crowded, Sight};
use crate::light::Light;
use crate::project::ScreenPoint;
use crate::raster::{NONE, Raster};
use crate::render::{Cotangents, Rendered};
use crate::shade::{Lit, Posed};
use crate::silhouette::{Crossing, Silhouette, silhouette};
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
    let first_look = surface.look_of_triangle.first();
    let one_look = surface.look_of_triangle.iter().all(|l| Some(l) == first_look);
    let no_jumps = one_look && (surface.unlit || !surface.normals.is_flat());
    let raster = &rendered.raster;
    let silhouette = silhouette(
        &surface.topology,
        &surface.triangles,
        posed.screen,
        &surface.cull_back,
        raster.width,
        raster.height,
    );
    let w = raster.width;
    let between = if surface.has_cutouts {
        // What a cutout leaves of a triangle is not known between pixels.
        Between::default()
    } else {
        Between::new(&silhouette, &raster.inv_z, w, &surface.triangles, posed.screen, &surface.cull_back)
    };
    let mut edges =
        Edges { posed, light, rendered, d, silhouette, between, no_jumps, encoder: Encoder::new(), d_screen };
    edges.crowded_pairs();
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
    silhouette: Silhouette,
    between: Between,
    /// Triangles that share a corner have no jump between them: one look, smooth or no shading.
    no_jumps: bool,
    encoder: Encoder,
    d_screen: &'a mut [ScreenPoint],
}

impl Edges<'_> {
    fn pair(&mut self, a: usize, b: usize, axis: Axis) {
        let raster = &self.rendered.raster;
        let (ta, tb) = (raster.triangle[a], raster.triangle[b]);
        if ta == NONE || tb == NONE {
            if !self.between.contains(pair_of(a, axis)) {
                self.step(a, b, axis, tb == NONE);
            }
            return;
        }
        if self.d.rgb.is_empty() {
            return;
        }
        let (va, vb) = (self.posed.surface.triangles[ta as usize], self.posed.surface.triangles[tb as usize]);
        // Without short circuits, which would be mispredicted: this is asked at almost every pixel of a fine mesh.
        let shared = va.iter().fold(false, |any, &v| any | (v == vb[0]) | (v == vb[1]) | (v == vb[2]));
        let outlines = &self.silhouette.vertices;
        let outline = |v: [u32; 3]| outlines[v[0] as usize] | outlines[v[1] as usize] | outlines[v[2] as usize];
        let inner = !(outline(va) | outline(vb));
        if shared && inner && self.no_jumps {
            return;
        }
        if self.between.contains(pair_of(a, axis)) {
            return;
        }
        let joined = shared || self.joined(va, vb);
        let step = if joined && inner { Step::Continuous } else { self.classify(a, b, axis) };
        match step {
            Step::First => self.step(a, b, axis, true),
            Step::Second => self.step(a, b, axis, false),
            // Between triangles that do not even touch, something small lies that no pixel shows: no jump can be told.
            Step::Continuous if joined || !self.no_jumps => {
                let g = 0.5 * self.jump(a, b, axis);
                self.scatter(a, axis, 1.0, g);
                self.scatter(b, axis, -1.0, g);
            }
            Step::Continuous | Step::Intersection => {}
        }
    }

    /// The steps between pixels that several silhouettes cross, thin parts that no pixel shows among them.
    fn crowded_pairs(&mut self) {
        let between = std::mem::take(&mut self.between);
        for crowded in &between.crowded {
            self.crowded_pair(crowded, &between);
        }
        self.between = between;
    }

    fn crowded_pair(&mut self, crowded: &Crowded, between: &Between) {
        let raster = &self.rendered.raster;
        let a = crowded.pair as usize / 2;
        let (axis, b) = if crowded.pair % 2 == 1 { (Axis::Y, a + raster.width) } else { (Axis::X, a + 1) };
        let crossings = &between.crossings[crowded.crossings.clone()];
        for (c, behind) in crossings.iter().zip(&between.sights[crowded.crossings.clone()]) {
            if behind.q < c.q {
                self.seen_step(a, b, axis, c, behind);
            }
        }
    }

    /// The step at a crossing that is seen, with what lies behind it.
    fn seen_step(&mut self, a: usize, b: usize, axis: Axis, c: &Crossing, behind: &Sight) {
        let sign = if c.surface_first { 0.5 } else { -0.5 };
        let mut g = 0.0;
        if !self.d.mask.is_empty() && behind.triangle == NONE {
            g += sign * (self.d.mask[a] + self.d.mask[b]);
        }
        if !self.d.rgb.is_empty() {
            let (da, db) = (self.d.rgb[a], self.d.rgb[b]);
            if let (Some(color), Some(behind)) = (self.color_of(c), self.color_seen(behind)) {
                g += (0..3).map(|k| sign * (da[k] + db[k]) * (color[k] - behind[k])).sum::<f32>();
            }
        }
        self.add(c.vertices[0], axis, f64::from(g * (1.0 - c.s)));
        self.add(c.vertices[1], axis, f64::from(g * c.s));
    }

    /// Colour at a sight line.
    fn color_seen(&self, s: &Sight) -> Option<[f32; 3]> {
        if s.triangle == NONE {
            Some(self.rendered.background)
        } else {
            self.color_at(s.triangle, s.x as f32, s.y as f32)
        }
    }

    /// A step between a surface (the first pixel's or the second's) and what is behind it.
    fn step(&mut self, a: usize, b: usize, axis: Axis, first: bool) {
        let (front, back) = if first { (a, b) } else { (b, a) };
        let sign = if first { 1.0 } else { -1.0 };
        let crossing = self.crossing(a, back, axis, first);
        let mut g = 0.0;
        if !self.d.mask.is_empty() && !self.rendered.raster.covered(back) {
            g += 0.5 * sign * (self.d.mask[a] + self.d.mask[b]);
        }
        if !self.d.rgb.is_empty() {
            let (da, db) = (self.d.rgb[a], self.d.rgb[b]);
            let rgb = &self.rendered.rgb;
            let color = crossing.and_then(|c| self.color_of(&c)).unwrap_or(rgb[front]);
            let behind = rgb[back];
            g += (0..3).map(|k| 0.5 * sign * (da[k] + db[k]) * (color[k] - behind[k])).sum::<f32>();
        }
        match crossing {
            Some(c) => {
                self.add(c.vertices[0], axis, f64::from(g * (1.0 - c.s)));
                self.add(c.vertices[1], axis, f64::from(g * c.s));
            }
            None => self.scatter(front, axis, sign.into(), g),
        }
    }

    /// The outermost silhouette of the surface in front between two pixels, before what the other pixel shows.
    fn crossing(&self, a: usize, back: usize, axis: Axis, first: bool) -> Option<Crossing> {
        let pair = pair_of(a, axis);
        let behind = self.rendered.raster.inv_z[back];
        let found = self.silhouette.at(pair).iter().filter(|c| c.surface_first == first && c.q > behind);
        let outermost = |x: &&Crossing, y: &&Crossing| if first { x.t.total_cmp(&y.t) } else { y.t.total_cmp(&x.t) };
        found.max_by(outermost).copied()
    }

    /// Colour of the surface at a crossing.
    fn color_of(&self, c: &Crossing) -> Option<[f32; 3]> {
        let corners = self.posed.corners(c.triangle, true);
        corners.weights.as_ref()?;
        let affine = [1.0 - c.s, c.s];
        let mut b = [0.0; 3];
        for (v, l) in c.vertices.iter().zip(affine) {
            // The crossing's vertices are the first triangle's; the other may have its own copies of them.
            let joined = &self.posed.surface.topology.joined;
            let k = corners.vertices.iter().position(|&k| joined[k] == joined[*v as usize])?;
            b[k] += l * self.posed.screen[*v as usize].q as f32 / c.q;
        }
        let fragment = corners.fragment(b, c.q);
        Some(self.encoder.encode_rgb(Lit::new(self.light, &fragment).linear))
    }

    fn add(&mut self, vertex: u32, axis: Axis, d: f64) {
        let at = &mut self.d_screen[vertex as usize];
        match axis {
            Axis::X => at.x += d,
            Axis::Y => at.y += d,
        }
    }

    /// ½ Σ_c (∂L/∂I_A + ∂L/∂I_B)(I_A − I_B) with the colours that both triangles have in the middle between the pixels; zero
    /// where they share smooth attributes.
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

    fn joined(&self, va: [u32; 3], vb: [u32; 3]) -> bool {
        let joined = &self.posed.surface.topology.joined;
        let other = vb.map(|v| joined[v as usize]);
        va.iter().any(|&v| other.contains(&joined[v as usize]))
    }

    fn classify(&self, a: usize, b: usize, axis: Axis) -> Step {
        let raster = &self.rendered.raster;
        let (ta, tb) = (raster.triangle[a], raster.triangle[b]);
        let (pa, pb) = (self.points(ta), self.points(tb));
        let (ca, cb) = (centre(raster, a), centre(raster, b));
        match (contains(&pb, ca), contains(&pa, cb)) {
            (true, false) => Step::First,
            (false, true) => Step::Second,
            (true, true) => Step::Intersection,
            (false, false) => {
                let first = raster.inv_z[a] > raster.inv_z[b];
                match self.crossing(a, if first { b } else { a }, axis, first) {
                    None => Step::Continuous,
                    Some(_) if first => Step::First,
                    Some(_) => Step::Second,
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
            self.add(v, axis, l * f64::from(g));
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

/// As [`Crossing::pair`], of a pixel and the next one along an axis.
fn pair_of(pixel: usize, axis: Axis) -> u32 {
    2 * pixel as u32 + u32::from(matches!(axis, Axis::Y))
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

#[cfg(test)]
mod tests {
    use crate::light::Light;
    use crate::render::{Cotangents, render, render_vjp};
    use crate::surface::Surface;
    use animimic_scene::{Camera, Look, Mesh};
    use glam::{DAffine3, DVec2, DVec3};

    #[test]
    fn the_area_of_a_triangle_changes_with_its_corners_as_geometry_says() {
        let corners = [DVec2::new(10.3, 8.7), DVec2::new(52.1, 20.4), DVec2::new(21.9, 49.2)];
        let mesh = Mesh {
            positions: corners.iter().map(|c| c.extend(1.0)).collect(),
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let surface = Surface::new(&mesh, &[Look::default()]).expect("the triangle is sound");
        let (mask, shifts) = (vec![1.0; 64 * 64], 16);
        let mut sum = [DVec3::ZERO; 3];
        for k in 0..shifts * shifts {
            let (cx, cy) = ((k % shifts) as f64 / shifts as f64, (k / shifts) as f64 / shifts as f64);
            let view_from_world = DAffine3::IDENTITY;
            let camera = Camera { width: 64, height: 64, fx: 1.0, fy: 1.0, cx, cy, view_from_world };
            let light = Light::default();
            let rendered = render(&camera, &surface, &mesh.positions, &light, [1.0; 3]);
            let d = Cotangents { mask: &mask, ..Cotangents::default() };
            let g = render_vjp(&camera, &surface, &mesh.positions, &light, &rendered, &d, false);
            (0..3).for_each(|i| sum[i] += g.positions[i] / f64::from(shifts as u32).powi(2));
        }
        let mut worst = 0.0f64;
        for i in 0..3 {
            // Area = ½ |(p1 − p0) × (p2 − p0)|.
            let side = corners[(i + 2) % 3] - corners[(i + 1) % 3];
            let exact = 0.5 * DVec2::new(-side.y, side.x);
            println!("corner {i}: {:.3} {:.3}, exact {exact:.3}", sum[i].x, sum[i].y);
            worst = worst.max((sum[i].truncate() - exact).length() / exact.length());
        }
        println!("relative error {worst:.1e}");
        assert!(worst < 1e-2);
    }
}

//! Perspective-correct interpolation inside one triangle.
//!
//! With λ the affine screen weights and qᵢ = 1/zᵢ: Q = Σ λᵢ qᵢ = 1/z, bᵢ = λᵢ qᵢ / Q. Both bᵢ·Q and Q are linear on the screen.

use crate::project::ScreenPoint;

/// The weights of one triangle as functions of the screen position.
#[derive(Clone, Copy, Debug)]
pub struct Weights {
    /// The third vertex: where the linear functions are anchored.
    x: f32,
    y: f32,
    /// Slopes along x and y of b0·Q, b1·Q (both zero at the anchor).
    b0: [f32; 2],
    b1: [f32; 2],
    /// Value at the anchor and slopes of Q.
    q: [f32; 3],
    /// 1/qᵢ of the three vertices.
    z: [f32; 3],
}

/// ∂L/∂(x, y, q) of a triangle's three screen points, summed over its pixels in single precision.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DCorners {
    /// ∂L/∂x per vertex.
    pub x: [f32; 3],
    /// ∂L/∂y per vertex.
    pub y: [f32; 3],
    /// ∂L/∂q per vertex.
    pub q: [f32; 3],
}

impl DCorners {
    /// Hands the sums to the triangle's vertices and starts again at zero.
    #[inline(always)]
    pub fn flush(&mut self, vertices: [usize; 3], d_screen: &mut [ScreenPoint]) {
        for (k, &v) in vertices.iter().enumerate() {
            if let Some(d) = d_screen.get_mut(v) {
                d.x += f64::from(self.x[k]);
                d.y += f64::from(self.y[k]);
                d.q += f64::from(self.q[k]);
            }
        }
        *self = Self::default();
    }
}

impl Weights {
    /// `None` where a vertex lies behind the camera or the triangle is edge-on.
    pub fn new(p: [ScreenPoint; 3]) -> Option<Self> {
        // Relative to the third vertex in f64: exact for the smallest triangles, then rounded once.
        let (ax, ay, bx, by) = (p[0].x - p[2].x, p[0].y - p[2].y, p[1].x - p[2].x, p[1].y - p[2].y);
        let inv = 1.0 / (ax * by - bx * ay);
        if !inv.is_finite() || p.iter().any(|p| p.q <= 0.0) {
            return None;
        }
        // λ0 = ((x − x2)·by − (y − y2)·bx)·inv, λ1 = ((y − y2)·ax − (x − x2)·ay)·inv, λ2 = 1 − λ0 − λ1.
        let l0 = [by * inv, -bx * inv];
        let l1 = [-ay * inv, ax * inv];
        let slope = |k: usize| p[0].q * l0[k] + p[1].q * l1[k] - p[2].q * (l0[k] + l1[k]);
        Some(Self {
            x: p[2].x as f32,
            y: p[2].y as f32,
            b0: [(p[0].q * l0[0]) as f32, (p[0].q * l0[1]) as f32],
            b1: [(p[1].q * l1[0]) as f32, (p[1].q * l1[1]) as f32],
            q: [p[2].q as f32, slope(0) as f32, slope(1) as f32],
            z: [1.0 / p[0].q as f32, 1.0 / p[1].q as f32, 1.0 / p[2].q as f32],
        })
    }

    /// Weights of the first and second vertex at a screen position.
    #[inline(always)]
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let (dx, dy) = (x - self.x, y - self.y);
        let inv = 1.0 / (self.q[0] + self.q[1] * dx + self.q[2] * dy);
        [(self.b0[0] * dx + self.b0[1] * dy) * inv, (self.b1[0] * dx + self.b1[1] * dy) * inv]
    }

    /// Inverse depth Q at a screen position.
    #[inline(always)]
    pub fn inverse_depth(&self, x: f32, y: f32) -> f32 {
        self.q[0] + self.q[1] * (x - self.x) + self.q[2] * (y - self.y)
    }

    /// ∂b0 and ∂b1 along x and y at a position where the weights are `b` and inverse depth is `q`: `[b0 or b1][x or y]`.
    #[inline(always)]
    pub fn slopes(&self, b: [f32; 2], q: f32) -> [[f32; 2]; 2] {
        let inv = 1.0 / q;
        let along = |s: [f32; 2], b: f32| [(s[0] - b * self.q[1]) * inv, (s[1] - b * self.q[2]) * inv];
        [along(self.b0, b[0]), along(self.b1, b[1])]
    }

    /// Affine screen weights λᵢ = bᵢ Q / qᵢ.
    #[inline(always)]
    pub fn affine(&self, b: [f32; 3], q: f32) -> [f32; 3] {
        [0, 1, 2].map(|i| b[i] * q * self.z[i])
    }

    /// Adjoint of the weights and the inverse depth of one pixel: `d_b` = ∂L/∂bᵢ and `d_q` = ∂L/∂Q, with all pixels staying
    /// where they are → added to the corners' cotangents.
    ///
    /// With g̃ᵢ = d_bᵢ − Σ bₖ d_bₖ: ∂L/∂λᵢ = qᵢ(g̃ᵢ/Q + d_q), ∂L/∂qᵢ = λᵢ(g̃ᵢ/Q + d_q); a vertex moving by δ carries the affine
    /// weights along, δλᵢ = −λⱼ ∇λᵢ·δ.
    #[inline(always)]
    pub fn at_vjp(&self, b: [f32; 3], q: f32, d_b: [f32; 3], d_q: f32, out: &mut DCorners) {
        let mean = b[0] * d_b[0] + b[1] * d_b[1] + b[2] * d_b[2];
        let inv = 1.0 / q;
        let k = d_b.map(|d| (d - mean) * inv + d_q);
        // Σ (∂L/∂λᵢ) ∇λᵢ; qᵢ∇λᵢ are the stored slopes, the third one by ∇Q = Σ qᵢ∇λᵢ.
        let along = |a: usize| k[0] * self.b0[a] + k[1] * self.b1[a] + k[2] * (self.q[1 + a] - self.b0[a] - self.b1[a]);
        let (hx, hy) = (-along(0), -along(1));
        let l = self.affine(b, q);
        for i in 0..3 {
            out.x[i] += l[i] * hx;
            out.y[i] += l[i] * hy;
            out.q[i] += l[i] * k[i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};

    #[test]
    fn weights_and_depth_have_an_exact_gradient_to_the_screen_points() {
        let mut rng = SplitMix64(8);
        let mut worst = 0.0f64;
        for _ in 0..20 {
            let x: Vec<f64> =
                (0..3).flat_map(|_| [10.0 * rng.uniform(), 10.0 * rng.uniform(), 0.3 + 0.4 * rng.uniform()]).collect();
            let points = |x: &[f64]| [0, 1, 2].map(|i| ScreenPoint { x: x[3 * i], y: x[3 * i + 1], q: x[3 * i + 2] });
            let p = points(&x);
            let area = (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[2].x - p[0].x) * (p[1].y - p[0].y);
            if area.abs() < 10.0 {
                continue;
            }
            let at = [(p[0].x + p[1].x + p[2].x) / 3.0, (p[0].y + p[1].y + p[2].y) / 3.0 + 0.2];
            let (d_b, d_q) = ([0.7, -0.4, 0.9], 1.3);
            // The same formulas in double precision, from the definition.
            let f = |x: &[f64]| {
                let p = points(x);
                let cross = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
                    (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
                };
                let s = p.map(|p| [p.x, p.y]);
                let area = cross(s[0], s[1], s[2]);
                let l = [cross(s[1], s[2], at) / area, cross(s[2], s[0], at) / area, cross(s[0], s[1], at) / area];
                let q: f64 = (0..3).map(|i| l[i] * p[i].q).sum();
                (0..3).map(|i| d_b[i] * l[i] * p[i].q / q).sum::<f64>() + d_q * q
            };
            let w = Weights::new(p).unwrap();
            let [b0, b1] = w.at(at[0] as f32, at[1] as f32);
            let b = [b0, b1, 1.0 - b0 - b1];
            let mut d = DCorners::default();
            w.at_vjp(b, w.inverse_depth(at[0] as f32, at[1] as f32), d_b.map(|d| d as f32), d_q as f32, &mut d);
            let g: Vec<f64> = (0..3).flat_map(|i| [d.x[i], d.y[i], d.q[i]].map(f64::from)).collect();
            worst = worst.max(gradient_error(f, &x, &g, 4, &[1e-3, 1e-4, 1e-5], 5));
        }
        println!("weights: gradient error {worst:.1e} (single precision)");
        assert!(worst < 1e-5);
    }
}

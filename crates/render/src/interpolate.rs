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
        })
    }

    /// Weights of the first and second vertex at a screen position.
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let (dx, dy) = (x - self.x, y - self.y);
        let inv = 1.0 / (self.q[0] + self.q[1] * dx + self.q[2] * dy);
        [(self.b0[0] * dx + self.b0[1] * dy) * inv, (self.b1[0] * dx + self.b1[1] * dy) * inv]
    }

    /// ∂b0 and ∂b1 along x and y at a position where the weights are `b` and inverse depth is `q`: `[b0 or b1][x or y]`.
    pub fn slopes(&self, b: [f32; 2], q: f32) -> [[f32; 2]; 2] {
        let inv = 1.0 / q;
        let along = |s: [f32; 2], b: f32| [(s[0] - b * self.q[1]) * inv, (s[1] - b * self.q[2]) * inv];
        [along(self.b0, b[0]), along(self.b1, b[1])]
    }
}

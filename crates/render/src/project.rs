//! World points → screen points.
//!
//! View space v = M·x (OpenCV: x right, y down, z forward); screen x = fx·v.x/v.z + cx, y = fy·v.y/v.z + cy, q = 1/v.z.
//! 1/z is kept instead of z because it is what is linear on the screen.

use animimic_scene::Camera;
use glam::{DMat3, DVec3};

/// A projected vertex: pixel coordinates (pixel centres at +0.5) and inverse depth. f64, like all geometry.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScreenPoint {
    /// Pixel column coordinate [px].
    pub x: f64,
    /// Pixel row coordinate, downwards [px].
    pub y: f64,
    /// 1/z along the camera axis [1 / model unit]; not positive behind the camera, where x and y mean nothing.
    pub q: f64,
}

/// The adjoint of a camera: what a change of each of its numbers does to the loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DCamera {
    /// ∂L/∂fx.
    pub fx: f64,
    /// ∂L/∂fy.
    pub fy: f64,
    /// ∂L/∂cx.
    pub cx: f64,
    /// ∂L/∂cy.
    pub cy: f64,
    /// ∂L/∂(linear part of `view_from_world`), entry by entry.
    pub linear: DMat3,
    /// ∂L/∂(translation of `view_from_world`).
    pub translation: DVec3,
}

impl Default for DCamera {
    fn default() -> Self {
        // Written out because a matrix's own default is the identity.
        Self { fx: 0.0, fy: 0.0, cx: 0.0, cy: 0.0, linear: DMat3::ZERO, translation: DVec3::ZERO }
    }
}

impl DCamera {
    /// ∂L/∂ω for a small rotation of the camera: `view_from_world` ← exp(\[ω\]×)·`view_from_world` [1/rad].
    pub fn rotation(&self, camera: &Camera) -> DVec3 {
        let a = camera.view_from_world.matrix3;
        let columns = [(a.x_axis, self.linear.x_axis), (a.y_axis, self.linear.y_axis), (a.z_axis, self.linear.z_axis)];
        let turned: DVec3 = columns.iter().map(|(c, d)| c.cross(*d)).sum();
        turned + camera.view_from_world.translation.cross(self.translation)
    }

    /// Adds another adjoint to this one.
    pub fn add(&mut self, other: &DCamera) {
        self.fx += other.fx;
        self.fy += other.fy;
        self.cx += other.cx;
        self.cy += other.cy;
        self.linear += other.linear;
        self.translation += other.translation;
    }
}

/// Projects all `positions` (world space, per vertex).
pub fn project(camera: &Camera, positions: &[DVec3]) -> Vec<ScreenPoint> {
    positions
        .iter()
        .map(|&p| {
            let v = camera.to_view(p);
            let q = 1.0 / v.z;
            ScreenPoint { x: camera.fx * v.x * q + camera.cx, y: camera.fy * v.y * q + camera.cy, q }
        })
        .collect()
}

/// Adjoint of [`project`]: `d_screen` (∂L/∂x, ∂L/∂y, ∂L/∂q per vertex) → ∂L/∂positions (added) and the camera's adjoint.
/// Vertices with a zero cotangent are skipped, so points behind the camera do no harm.
pub fn project_vjp(
    camera: &Camera,
    positions: &[DVec3],
    d_screen: &[ScreenPoint],
    d_positions: &mut [DVec3],
) -> DCamera {
    let rotation_t = camera.view_from_world.matrix3.transpose();
    let mut d_camera = DCamera::default();
    for ((&p, d), d_position) in positions.iter().zip(d_screen).zip(d_positions) {
        if d.x == 0.0 && d.y == 0.0 && d.q == 0.0 {
            continue;
        }
        let v = camera.to_view(p);
        let q = 1.0 / v.z;
        let (ax, ay) = (camera.fx * q * d.x, camera.fy * q * d.y);
        let d_v = DVec3::new(ax, ay, -q * (ax * v.x + ay * v.y + q * d.q));
        *d_position += rotation_t * d_v;
        d_camera.fx += v.x * q * d.x;
        d_camera.fy += v.y * q * d.y;
        d_camera.cx += d.x;
        d_camera.cy += d.y;
        d_camera.translation += d_v;
        d_camera.linear += DMat3::from_cols(d_v * p.x, d_v * p.y, d_v * p.z);
    }
    d_camera
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};
    use glam::{DAffine3, DQuat};

    fn loss(screen: &[ScreenPoint], weights: &[ScreenPoint]) -> f64 {
        screen.iter().zip(weights).map(|(s, w)| s.x * w.x + s.y * w.y + s.q * w.q).sum()
    }

    #[test]
    fn projection_has_an_exact_gradient_to_points_and_to_every_camera_number() {
        let camera = Camera::orbit(DVec3::new(0.1, 0.2, 0.0), 3.0, 0.7, 0.3, 0.8, 100, 80);
        let mut rng = SplitMix64(3);
        let points: Vec<DVec3> = (0..12).map(|_| DVec3::new(rng.normal(), rng.normal(), rng.normal()) * 0.4).collect();
        let weights: Vec<ScreenPoint> =
            (0..12).map(|_| ScreenPoint { x: rng.normal(), y: rng.normal(), q: rng.normal() * 50.0 }).collect();
        // Parameters: points, then rotation vector, translation, fx, fy, cx, cy.
        let mut x: Vec<f64> = points.iter().flat_map(|p| p.to_array()).collect();
        let n = x.len();
        x.extend([0.0; 6]);
        x.extend([camera.fx, camera.fy, camera.cx, camera.cy]);
        let unpack = |x: &[f64]| {
            let points: Vec<DVec3> = x[..n].chunks(3).map(DVec3::from_slice).collect();
            let turn = DAffine3::from_quat(DQuat::from_scaled_axis(DVec3::from_slice(&x[n..n + 3])));
            let shift = DAffine3::from_translation(DVec3::from_slice(&x[n + 3..n + 6]));
            let view_from_world = shift * turn * camera.view_from_world;
            (points, Camera { fx: x[n + 6], fy: x[n + 7], cx: x[n + 8], cy: x[n + 9], view_from_world, ..camera })
        };
        let mut d_points = vec![DVec3::ZERO; 12];
        let d = project_vjp(&camera, &points, &weights, &mut d_points);
        let mut gradient: Vec<f64> = d_points.iter().flat_map(|p| p.to_array()).collect();
        gradient.extend(d.rotation(&camera).to_array());
        gradient.extend(d.translation.to_array());
        gradient.extend([d.fx, d.fy, d.cx, d.cy]);
        let f = |x: &[f64]| {
            let (points, camera) = unpack(x);
            loss(&project(&camera, &points), &weights)
        };
        let error = gradient_error(f, &x, &gradient, 12, &[1e-3, 1e-4, 1e-5], 5);
        println!("project: gradient error {error:.1e}");
        assert!(error < 1e-7);
    }
}

//! Projection of world points into the picture, with its derivative.

use animimic_scene::Camera;
use glam::{DVec2, DVec3};

/// A projected point and the rows of ∂(u, v)/∂x_world.
#[derive(Clone, Copy, Debug)]
pub struct Projected {
    /// Pixel position.
    pub pixel: DVec2,
    /// Depth along the camera axis [model unit].
    pub depth: f64,
    /// ∂u/∂x [px / model unit].
    pub du: DVec3,
    /// ∂v/∂x [px / model unit].
    pub dv: DVec3,
}

/// Points nearer than this share of the focal plane's unit are treated as lying on it: the projection is singular at z = 0.
const NEAREST_DEPTH: f64 = 1e-6;

/// Projects a world point; u = fx X/Z + cx.
pub fn project(camera: &Camera, x: DVec3) -> Projected {
    let r = camera.view_from_world.matrix3;
    let p = camera.to_view(x);
    let z = p.z.max(NEAREST_DEPTH);
    let iz = 1.0 / z;
    let (rx, ry, rz) = (r.row(0), r.row(1), r.row(2));
    Projected {
        pixel: DVec2::new(camera.fx * p.x * iz + camera.cx, camera.fy * p.y * iz + camera.cy),
        depth: p.z,
        du: (rx - rz * (p.x * iz)) * (camera.fx * iz),
        dv: (ry - rz * (p.y * iz)) * (camera.fy * iz),
    }
}

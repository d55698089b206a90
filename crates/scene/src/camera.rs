//! Pinhole cameras and the `camera.json` file.

use glam::{DAffine3, DMat3, DVec2, DVec3};

/// A pinhole camera in the OpenCV convention: x right, y down, z forward, u = fx·x/z + cx, pixel centres at +0.5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image width [px].
    pub width: u32,
    /// Image height [px].
    pub height: u32,
    /// Focal length along x [px].
    pub fx: f64,
    /// Focal length along y [px].
    pub fy: f64,
    /// Principal point x [px].
    pub cx: f64,
    /// Principal point y [px].
    pub cy: f64,
    /// Rigid map from world to view space.
    pub view_from_world: DAffine3,
}

/// What `camera.json` holds: the main camera, the frame rate and further named views.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFile {
    /// The input view.
    pub main: Camera,
    /// Frames per second of the video it belongs to.
    pub fps: f64,
    /// Other views by name (`novel_p45`, …), in file order.
    pub views: Vec<(String, Camera)>,
    /// Point that the views look at and orbit around, when the file states it.
    pub target: Option<DVec3>,
}

impl Camera {
    /// A camera on a circle around `target`: azimuth from +Z towards +X, elevation upwards [rad], vertical field of view [rad].
    pub fn orbit(
        target: DVec3,
        distance: f64,
        azimuth_rad: f64,
        elevation_rad: f64,
        fov_y_rad: f64,
        width: u32,
        height: u32,
    ) -> Self {
        let (sa, ca) = azimuth_rad.sin_cos();
        let (se, ce) = elevation_rad.sin_cos();
        let back = DVec3::new(ce * sa, se, ce * ca);
        let right = DVec3::new(ca, 0.0, -sa);
        let down = back.cross(right) * -1.0;
        let rotation = DMat3::from_cols(right, down, -back).transpose();
        let eye = target + back * distance;
        let f = 0.5 * f64::from(height) / (0.5 * fov_y_rad).tan();
        Self {
            width,
            height,
            fx: f,
            fy: f,
            cx: 0.5 * f64::from(width),
            cy: 0.5 * f64::from(height),
            view_from_world: DAffine3::from_mat3_translation(rotation, -(rotation * eye)),
        }
    }

    /// The same view with the camera turned by `azimuth_rad` about the vertical axis through `target`.
    pub fn orbited(&self, target: DVec3, azimuth_rad: f64) -> Self {
        let turn = DAffine3::from_translation(target)
            * DAffine3::from_rotation_y(-azimuth_rad)
            * DAffine3::from_translation(-target);
        Self { view_from_world: self.view_from_world * turn, ..*self }
    }

    /// The same view at another image size (anisotropic where the aspect changes).
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self { width, height, fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy, ..*self }
    }

    /// World point → view space (z = depth along the axis).
    pub fn to_view(&self, p: DVec3) -> DVec3 {
        self.view_from_world.transform_point3(p)
    }

    /// View-space point → pixel. Meaningful for z > 0 only.
    pub fn pixel_from_view(&self, v: DVec3) -> DVec2 {
        DVec2::new(self.fx * v.x / v.z + self.cx, self.fy * v.y / v.z + self.cy)
    }

    /// World point → pixel.
    pub fn project(&self, p: DVec3) -> DVec2 {
        self.pixel_from_view(self.to_view(p))
    }

    /// Where the camera stands, world space.
    pub fn eye(&self) -> DVec3 {
        self.view_from_world.inverse().translation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_camera_on_plus_z_looks_down_minus_z_with_x_to_the_right_and_y_up() {
        let c = Camera::orbit(DVec3::ZERO, 2.0, 0.0, 0.0, 1.0, 100, 100);
        assert!((c.eye() - DVec3::new(0.0, 0.0, 2.0)).length() < 1e-12);
        assert!(c.project(DVec3::X * 0.1).x > 50.0);
        assert!(c.project(DVec3::Y * 0.1).y < 50.0);
        assert!(c.view_from_world.matrix3.determinant() > 0.999);
    }

    #[test]
    fn orbiting_equals_an_orbit_camera_at_the_sum_of_the_azimuths() {
        let t = DVec3::new(0.3, 0.2, -0.1);
        let a = Camera::orbit(t, 2.0, 0.5, 0.2, 1.0, 64, 64).orbited(t, 0.7);
        let b = Camera::orbit(t, 2.0, 1.2, 0.2, 1.0, 64, 64);
        assert!((a.eye() - b.eye()).length() < 1e-12);
        assert!(a.view_from_world.abs_diff_eq(b.view_from_world, 1e-12));
    }
}

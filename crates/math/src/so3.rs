//! Rotations in three dimensions: exponential and logarithm (Rodrigues 1840), with their limits at 0 and π.

use glam::{DMat3, DVec3};

/// Below this angle [rad] the series replaces the closed form: its first neglected term is under 1e-17.
const SMALL_ANGLE_RAD: f64 = 1e-4;

/// Cross-product matrix: `skew(a) b = a × b`.
pub fn skew(a: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, a.z, -a.y), DVec3::new(-a.z, 0.0, a.x), DVec3::new(a.y, -a.x, 0.0))
}

/// Rotation by |w| radians about w.
pub fn exp(w: DVec3) -> DMat3 {
    let angle2 = w.length_squared();
    let angle = angle2.sqrt();
    let (a, b) = if angle < SMALL_ANGLE_RAD {
        (1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0)
    } else {
        (angle.sin() / angle, (1.0 - angle.cos()) / angle2)
    };
    let k = skew(w);
    DMat3::IDENTITY + k * a + k * k * b
}

/// Rotation vector of a rotation, |log R| ≤ π. Through the quaternion, hence regular at π.
pub fn log(r: &DMat3) -> DVec3 {
    let q = glam::DQuat::from_mat3(r).normalize();
    let (v, w) = if q.w < 0.0 { (-q.xyz(), -q.w) } else { (q.xyz(), q.w) };
    let s = v.length();
    if s < SMALL_ANGLE_RAD { v * (2.0 / w) * (1.0 - s * s / (3.0 * w * w)) } else { v * (2.0 * s.atan2(w) / s) }
}

/// Inverse right Jacobian of SO(3): log(R exp δ) = log R + J_r⁻¹(log R) δ + O(δ²) (Chirikjian 2012, eq. 10.86).
pub fn right_jacobian_inverse(w: DVec3) -> DMat3 {
    let angle2 = w.length_squared();
    let angle = angle2.sqrt();
    let c = if angle < 1e-3 {
        1.0 / 12.0 + angle2 / 720.0
    } else {
        1.0 / angle2 - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    };
    let k = skew(w);
    DMat3::IDENTITY + k * 0.5 + k * k * c
}

/// Nearest rotation to a matrix that drifted from one by rounding (Gram–Schmidt on its columns).
pub fn orthonormalized(r: &DMat3) -> DMat3 {
    let x = r.x_axis.normalize();
    let y = (r.y_axis - x * x.dot(r.y_axis)).normalize();
    DMat3::from_cols(x, y, x.cross(y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_inverts_exp_for_small_large_and_half_turn_angles() {
        let axis = DVec3::new(0.3, -0.5, 0.8).normalize();
        for angle in [0.0, 1e-9, 1e-5, 9e-5, 1.1e-4, 0.3, 2.0, 3.1, std::f64::consts::PI - 1e-9] {
            let back = log(&exp(axis * angle));
            assert!((back - axis * angle).length() < 1e-12 + 1e-13 * angle, "{angle}: {back:?}");
        }
    }

    #[test]
    fn the_inverse_right_jacobian_is_the_derivative_of_log() {
        for w in [DVec3::new(1e-5, 2e-5, 0.0), DVec3::new(0.4, -0.9, 0.2), DVec3::new(2.0, 1.0, -1.0)] {
            let d = DVec3::new(0.3, 0.7, -0.5) * 1e-6;
            let moved = (log(&(exp(w) * exp(d))) - log(&(exp(w) * exp(-d)))) / 2e-6;
            let linear = right_jacobian_inverse(w) * d / 1e-6;
            assert!((moved - linear).length() < 1e-8, "{moved:?} {linear:?}");
        }
    }

    #[test]
    fn exp_is_a_rotation() {
        let r = exp(DVec3::new(1.0, 2.0, -0.5));
        assert!((r.determinant() - 1.0).abs() < 1e-14);
        assert!((r * r.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-14));
    }
}

//! Vertex error: ‖x̂ − x‖ over frames and vertices, whole, split by view direction, and with each frame's rigid motion removed.
//!
//! The rigid alignment is Horn's closed form (Horn 1987, eq. 27–30): the rotation is the unit quaternion that maximises
//! qᵀNq, the largest eigenvector of the symmetric 4×4 matrix N built from the cross-covariance.

use super::{Evidence, Metric, Missing, Reading, percentile};
use glam::{DQuat, DVec3};
use rayon::prelude::*;

pub struct VertexError;

impl Metric for VertexError {
    fn name(&self) -> &'static str {
        "vertex error"
    }

    fn definition(&self) -> &'static str {
        "rms, p95, max over frames and vertices of |x̂ − x| in % of the rest diagonal; image-plane and depth parts; rms after rigid alignment per frame"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let truth = e.need_truth()?;
        let percent = 100.0 / e.diagonal();
        let pairs = || e.frames.iter().zip(&truth.vertices).flat_map(|(a, b)| a.iter().zip(b));
        let errors: Vec<f64> = pairs().map(|(a, b)| (*a - *b).length() * percent).collect();
        let rms = |squares: f64| (squares / errors.len().max(1) as f64).sqrt();
        let mut out = vec![
            ("vertex_rms_pct".into(), rms(errors.iter().map(|x| x * x).sum())),
            ("vertex_max_pct".into(), errors.iter().copied().fold(0.0, f64::max)),
        ];
        if let Some(camera) = e.camera {
            let (mut plane, mut depth) = (0.0, 0.0);
            for (a, b) in pairs() {
                let v = camera.view_from_world.transform_vector3(*a - *b);
                plane += v.x * v.x + v.y * v.y;
                depth += v.z * v.z;
            }
            out.push(("vertex_rms_plane_pct".into(), rms(plane) * percent));
            out.push(("vertex_rms_depth_pct".into(), rms(depth) * percent));
        }
        let aligned: Vec<f64> =
            e.frames.par_iter().zip(&truth.vertices).map(|(a, b)| aligned_square_error(a, b)).collect();
        out.push(("vertex_rms_aligned_pct".into(), rms(aligned.iter().sum()) * percent));
        let first = e.frames.first().map_or(0, Vec::len);
        out.push(("frame0_max_pct".into(), errors[..first].iter().copied().fold(0.0, f64::max)));
        let still: f64 = truth
            .vertices
            .iter()
            .flat_map(|f| f.iter().zip(&truth.vertices[0]))
            .map(|(a, b)| a.distance_squared(*b))
            .sum();
        out.push(("static_rms_pct".into(), rms(still) * percent));
        out.insert(1, ("vertex_p95_pct".into(), percentile(errors, 95.0)));
        Ok(out)
    }
}

/// Σ ‖R a + t − b‖² for the best rigid motion (R, t).
fn aligned_square_error(a: &[DVec3], b: &[DVec3]) -> f64 {
    let n = a.len().max(1) as f64;
    let (ca, cb) = (a.iter().sum::<DVec3>() / n, b.iter().sum::<DVec3>() / n);
    let r = best_rotation(a, ca, b, cb);
    a.iter().zip(b).map(|(p, q)| (r * (*p - ca)).distance_squared(*q - cb)).sum()
}

/// Rotation that takes `a − ca` nearest to `b − cb` in the least-squares sense.
fn best_rotation(a: &[DVec3], ca: DVec3, b: &[DVec3], cb: DVec3) -> DQuat {
    let mut s = [[0.0f64; 3]; 3];
    for (p, q) in a.iter().zip(b) {
        let (p, q) = ((*p - ca).to_array(), (*q - cb).to_array());
        for i in 0..3 {
            for j in 0..3 {
                s[i][j] += p[i] * q[j];
            }
        }
    }
    let n = [
        [s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]],
        [s[1][2] - s[2][1], s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
        [s[2][0] - s[0][2], s[0][1] + s[1][0], -s[0][0] + s[1][1] - s[2][2], s[1][2] + s[2][1]],
        [s[0][1] - s[1][0], s[2][0] + s[0][2], s[1][2] + s[2][1], -s[0][0] - s[1][1] + s[2][2]],
    ];
    let [w, x, y, z] = largest_eigenvector(n);
    DQuat::from_xyzw(x, y, z, w).normalize()
}

/// Eigenvector of the largest eigenvalue of a symmetric 4×4 matrix, by cyclic Jacobi rotations.
fn largest_eigenvector(mut m: [[f64; 4]; 4]) -> [f64; 4] {
    // Convergence is quadratic: 6 sweeps reach machine precision for 4×4; 12 leave room.
    const SWEEPS: usize = 12;
    let mut v = [[0.0; 4]; 4];
    for i in 0..4 {
        v[i][i] = 1.0;
    }
    for _ in 0..SWEEPS {
        for p in 0..3 {
            for q in p + 1..4 {
                if m[p][q] == 0.0 {
                    continue;
                }
                let theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for k in 0..4 {
                    (m[k][p], m[k][q]) = (c * m[k][p] - s * m[k][q], s * m[k][p] + c * m[k][q]);
                }
                for k in 0..4 {
                    (m[p][k], m[q][k]) = (c * m[p][k] - s * m[q][k], s * m[p][k] + c * m[q][k]);
                    (v[k][p], v[k][q]) = (c * v[k][p] - s * v[k][q], s * v[k][p] + c * v[k][q]);
                }
            }
        }
    }
    let best = (1..4).fold(0, |b, i| if m[i][i] > m[b][b] { i } else { b });
    [v[0][best], v[1][best], v[2][best], v[3][best]]
}

#[cfg(test)]
mod tests {
    use super::super::fixtures;
    use super::*;
    use crate::truth::Truth;

    #[test]
    fn a_rigid_motion_between_point_sets_is_removed_exactly_and_a_reflection_is_not() {
        let a: Vec<DVec3> =
            (0..20).map(|i| DVec3::new((i as f64).sin(), (2.3 * i as f64).cos(), (0.7 * i as f64).sin())).collect();
        let r = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 2.9);
        let b: Vec<DVec3> = a.iter().map(|p| r * *p + DVec3::new(3.0, -1.0, 2.0)).collect();
        let left = aligned_square_error(&a, &b);
        let mirrored: Vec<DVec3> = a.iter().map(|p| DVec3::new(-p.x, p.y, p.z)).collect();
        let kept = aligned_square_error(&a, &mirrored);
        println!("rigid {left:e}, reflection {kept:e}");
        assert!(left < 1e-25 && kept > 1.0);
    }

    #[test]
    fn an_offset_of_one_percent_in_depth_is_one_percent_rms_all_of_it_depth() {
        let (asset, frames) = fixtures::sliding(0.1, 3);
        let shift = DVec3::Z * (0.01 * super::super::diagonal(&frames[0]));
        let result: Vec<Vec<DVec3>> = frames.iter().map(|f| f.iter().map(|p| *p + shift).collect()).collect();
        let truth = Truth { vertices: frames, ..Default::default() };
        let camera = animimic_scene::Camera::orbit(DVec3::ZERO, 5.0, 0.0, 0.0, 0.8, 64, 64);
        let e = Evidence { truth: Some(&truth), camera: Some(&camera), ..fixtures::evidence(&asset, &result) };
        let readings = VertexError.measure(&e).unwrap();
        let get = |k: &str| readings.iter().find(|r| r.0 == k).unwrap().1;
        println!("{readings:?}");
        assert!((get("vertex_rms_pct") - 1.0).abs() < 1e-12);
        assert!((get("vertex_rms_depth_pct") - 1.0).abs() < 1e-12);
        assert!(get("vertex_rms_plane_pct") < 1e-12 && get("vertex_rms_aligned_pct") < 1e-12);
    }
}

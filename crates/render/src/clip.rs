//! Cutting triangles at the near plane.

use glam::DVec3;

/// The part of a view-space triangle with z ≥ `near` as a convex polygon of 0, 3 or 4 corners, in the triangle's order
/// (Sutherland and Hodgman 1974, one plane).
pub fn clip_near(triangle: &[DVec3; 3], near: f64) -> Vec<DVec3> {
    let mut out = Vec::with_capacity(4);
    for k in 0..3 {
        let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
        if a.z >= near {
            out.push(a);
        }
        if (a.z >= near) != (b.z >= near) {
            // From the nearer to the farther end, so that the two triangles at an edge cut it at the same point.
            let (lo, hi) = if a.z < b.z { (a, b) } else { (b, a) };
            let s = (near - lo.z) / (hi.z - lo.z);
            out.push(DVec3::new(lo.x + s * (hi.x - lo.x), lo.y + s * (hi.y - lo.y), near));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_is_kept_cut_to_three_or_four_corners_or_dropped() {
        let t = |z: [f64; 3]| [DVec3::new(0.0, 0.0, z[0]), DVec3::new(1.0, 0.0, z[1]), DVec3::new(0.0, 1.0, z[2])];
        let corners: Vec<usize> = [[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0; 3]]
            .iter()
            .map(|&z| clip_near(&t(z), 0.1).len())
            .collect();
        assert_eq!(corners, [3, 4, 3, 0]);
        assert!(clip_near(&t([1.0, 1.0, -1.0]), 0.1).iter().all(|v| v.z >= 0.1));
    }
}

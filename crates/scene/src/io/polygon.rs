//! Polygons → triangles, by clipping ears in the polygon's mean plane.

use glam::{DVec2, DVec3};

/// Polygons with more corners are fanned: ear clipping takes quadratic time.
const MAX_CLIPPED: usize = 512;

/// Triangles of a polygon as triples of corner numbers `0..corners.len()`, with its winding. Degenerate polygons are fanned.
pub(crate) fn triangulate(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let fan = |n: usize| (1..n.saturating_sub(1)).map(|i| [0, i, i + 1]).collect();
    if corners.len() <= 3 || corners.len() > MAX_CLIPPED {
        return fan(corners.len());
    }
    let Some(normal) = newell(corners).try_normalize() else { return fan(corners.len()) };
    let u = normal.any_orthonormal_vector();
    let v = normal.cross(u);
    let flat: Vec<DVec2> = corners.iter().map(|p| DVec2::new(p.dot(u), p.dot(v))).collect();
    clip(&flat).unwrap_or_else(|| fan(corners.len()))
}

/// Newell's area normal.
fn newell(corners: &[DVec3]) -> DVec3 {
    let n = corners.len();
    (0..n).map(|i| (corners[i] - corners[0]).cross(corners[(i + 1) % n] - corners[0])).sum()
}

fn clip(flat: &[DVec2]) -> Option<Vec<[usize; 3]>> {
    let mut ring: Vec<usize> = (0..flat.len()).collect();
    let mut out = Vec::with_capacity(flat.len() - 2);
    while ring.len() > 3 {
        let n = ring.len();
        let corner = |i: usize| [ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]];
        let ear = (0..n).find(|&i| is_ear(flat, corner(i), &ring))?;
        out.push(corner(ear));
        ring.remove(ear);
    }
    out.push([ring[0], ring[1], ring[2]]);
    Some(out)
}

fn is_ear(flat: &[DVec2], [a, b, c]: [usize; 3], ring: &[usize]) -> bool {
    let side = |p: DVec2, q: DVec2, r: DVec2| (q - p).perp_dot(r - p);
    if side(flat[a], flat[b], flat[c]) <= 0.0 {
        return false;
    }
    let inside = |p: DVec2| {
        side(flat[a], flat[b], p) >= 0.0 && side(flat[b], flat[c], p) >= 0.0 && side(flat[c], flat[a], p) >= 0.0
    };
    ring.iter().all(|&i| i == a || i == b || i == c || !inside(flat[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_concave_polygon_is_covered_once() {
        let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (2.0, 0.5), (0.0, 3.0)].map(|(x, y)| DVec3::new(x, y, 1.0));
        let triangles = triangulate(&corners);
        let area = |t: &[usize; 3]| 0.5 * (corners[t[1]] - corners[t[0]]).cross(corners[t[2]] - corners[t[0]]).z;
        let shoelace = 0.5 * newell(&corners).z;
        let sum: f64 = triangles.iter().map(area).sum();
        assert!(triangles.iter().all(|t| area(t) > 0.0), "{triangles:?}");
        assert!((sum - shoelace).abs() < 1e-12, "{sum} of {shoelace}");
        assert_eq!(triangles.len(), 3);
    }
}

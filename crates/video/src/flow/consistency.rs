//! Forward–backward consistency: where going there and back does not return, the flow is wrong or the point is hidden.

use super::Flow;

/// ‖f(p) + b(p + f(p))‖ [px] per pixel of the forward flow; infinite where the forward flow leaves the image.
pub fn consistency(forward: &Flow, backward: &Flow) -> Vec<f32> {
    let (w, h) = (forward.width as f32, forward.height as f32);
    let mut out = Vec::with_capacity(forward.vectors.len());
    for y in 0..forward.height {
        for x in 0..forward.width {
            let f = forward.vectors[y * forward.width + x];
            let q = [x as f32 + 0.5 + f[0], y as f32 + 0.5 + f[1]];
            if q[0] < 0.0 || q[1] < 0.0 || q[0] > w || q[1] > h {
                out.push(f32::INFINITY);
                continue;
            }
            let b = backward.at(q);
            out.push((f[0] + b[0]).hypot(f[1] + b[1]));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opposite_shifts_are_consistent_and_equal_ones_are_not() {
        let shift = |v| Flow { width: 8, height: 6, vectors: vec![v; 48] };
        let good = consistency(&shift([1.5, -0.5]), &shift([-1.5, 0.5]));
        assert!(good[2 * 8 + 3] < 1e-6);
        assert_eq!(good[7], f32::INFINITY, "the right column leaves the image");
        assert!((consistency(&shift([1.0, 0.0]), &shift([1.0, 0.0]))[2 * 8 + 3] - 2.0).abs() < 1e-6);
    }
}

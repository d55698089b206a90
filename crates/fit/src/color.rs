//! Comparing colours.

/// Luma of Rec. 601 from sRGB-encoded values, in their unit.
pub(crate) fn luma([r, g, b]: [f64; 3]) -> f64 {
    0.299 * r + 0.587 * g + 0.114 * b
}

/// Largest channel difference [8-bit levels].
pub(crate) fn color_distance(a: [u8; 3], b: [u8; 3]) -> f64 {
    (0..3).map(|c| (f64::from(a[c]) - f64::from(b[c])).abs()).fold(0.0, f64::max)
}

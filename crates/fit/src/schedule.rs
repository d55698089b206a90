//! How constants change from round to round.

/// Geometric interpolation: `first` at u = 0, `last` at u = 1.
pub(crate) fn geometric((first, last): (f64, f64), u: f64) -> f64 {
    first * (last / first).powf(u)
}

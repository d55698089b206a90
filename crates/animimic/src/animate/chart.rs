//! Line charts as SVG text.

use std::fmt::Write;

/// Width and height of a chart [px].
const SIZE: (f64, f64) = (520.0, 180.0);
/// Room for labels [px].
const MARGIN: f64 = 44.0;

/// Values over their index, on a logarithmic axis where all are positive.
pub fn line_chart(title: &str, values: &[f64]) -> String {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let (low, high) = finite.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), &v| (lo.min(v), hi.max(v)));
    if finite.is_empty() {
        return String::new();
    }
    let log = low > 0.0;
    let scale = |v: f64| if log { v.ln() } else { v };
    let span = (scale(high) - scale(low)).max(1e-12);
    let x = |i: usize| MARGIN + (SIZE.0 - MARGIN - 8.0) * i as f64 / (values.len().max(2) - 1) as f64;
    let y = |v: f64| SIZE.1 - 24.0 - (SIZE.1 - 48.0) * (scale(v) - scale(low)) / span;
    let mut points = String::new();
    for (i, &v) in values.iter().enumerate().filter(|(_, v)| v.is_finite()) {
        let _ = write!(points, "{:.1},{:.1} ", x(i), y(v));
    }
    let (w, h) = SIZE;
    format!(
        "<svg viewBox=\"0 0 {w} {h}\" width=\"{w}\" height=\"{h}\" role=\"img\" aria-label=\"{title}\">\
         <text x=\"{MARGIN}\" y=\"14\" class=\"t\">{title}</text>\
         <text x=\"2\" y=\"{:.1}\">{high:.3e}</text><text x=\"2\" y=\"{:.1}\">{low:.3e}</text>\
         <line x1=\"{MARGIN}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" class=\"axis\"/>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{} iterations</text>\
         <polyline points=\"{points}\"/></svg>",
        y(high) + 4.0,
        y(low) + 4.0,
        h - 22.0,
        w - 8.0,
        h - 22.0,
        w - 8.0,
        h - 6.0,
        values.len(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_value_is_at_the_top_and_the_last_at_the_right() {
        let svg = line_chart("loss", &[100.0, 10.0, 1.0]);
        assert!(svg.contains("44.0,24.0 278.0,90.0 512.0,156.0"), "{svg}");
        assert_eq!(line_chart("nothing", &[f64::NAN]), "");
    }
}

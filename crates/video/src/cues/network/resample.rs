//! Pictures of numbers at other sizes.

/// Weights of the source cells around each target cell in one dimension: (first source cell, weights summing to 1). A triangle filter as
/// wide as the coarser of the two grids, so that shrinking averages and enlarging interpolates: what imaging programs call bilinear.
fn triangle(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let scale = from as f64 / to as f64;
    let reach = scale.max(1.0);
    let cell = |i: usize| {
        let center = (i as f64 + 0.5) * scale;
        let first = ((center - reach).floor().max(0.0) as usize).min(from - 1);
        let last = ((center + reach).ceil() as usize).clamp(first + 1, from);
        let weights = (first..last).map(|s| (1.0 - (s as f64 + 0.5 - center).abs() / reach).max(0.0));
        let sum: f64 = weights.clone().sum();
        (first, weights.map(|w| (w / sum) as f32).collect())
    };
    (0..to).map(cell).collect()
}

/// `values` of `from` (width, height) at the size `to`.
pub fn resampled(values: &[f32], from: (usize, usize), to: (usize, usize)) -> Vec<f32> {
    let (columns, rows) = (triangle(from.0, to.0), triangle(from.1, to.1));
    let mut narrow = Vec::with_capacity(to.0 * from.1);
    for line in values.chunks(from.0) {
        let at =
            |(first, weights): &(usize, Vec<f32>)| weights.iter().zip(&line[*first..]).map(|(w, v)| w * v).sum::<f32>();
        narrow.extend(columns.iter().map(at));
    }
    let mut out = Vec::with_capacity(to.0 * to.1);
    for (first, weights) in &rows {
        let at = |x: usize| weights.iter().enumerate().map(|(k, w)| w * narrow[(first + k) * to.0 + x]).sum::<f32>();
        out.extend((0..to.0).map(at));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_stays_a_slope_at_any_size_and_a_constant_stays_itself() {
        let (w, h) = (40, 30);
        let slope: Vec<f32> = (0..w * h).map(|i| ((i % w) as f32 + 0.5) / w as f32).collect();
        for to in [(10, 7), (40, 30), (97, 61)] {
            let out = resampled(&slope, (w, h), to);
            let wrong = |i: usize| (out[i] - ((i % to.0) as f32 + 0.5) / to.0 as f32).abs();
            // At the border a filter sees one side only.
            let inner = (0..to.0 * to.1).filter(|i| (to.0 / 8..to.0 - to.0 / 8).contains(&(i % to.0)));
            let worst = inner.map(wrong).fold(0.0, f32::max);
            println!("{to:?}: {worst:.1e}");
            assert!(worst < 1e-6);
            assert!(resampled(&vec![3.0; w * h], (w, h), to).iter().all(|v| (v - 3.0).abs() < 1e-5));
        }
    }
}

//! Image pyramids: how far apart things that do not overlap still feel each other.
//!
//! A hard silhouette's gradient is confined to its edge. A loss on level k of a pyramid (means of 2ᵏ × 2ᵏ pixels) is a loss
//! with a soft edge 2ᵏ pixels wide, at a quarter of the cost a level, and its adjoint is exact: no blur in the renderer, no
//! softness parameter that depends on resolution.

/// One level: `channels` values a pixel, interleaved.
#[derive(Clone, Debug, PartialEq)]
pub struct PyramidLevel {
    /// Width [cell].
    pub width: usize,
    /// Height [cell].
    pub height: usize,
    /// Values, `[(y * width + x) * channels + channel]`.
    pub values: Vec<f32>,
}

/// Levels 0 (the input itself) to `levels` − 1; each is half as large (rounded up), cells at the border are means of the pixels
/// that exist. Ends early at 1 × 1.
///
/// # Panics
/// When `values` does not hold `width * height * channels` numbers.
pub fn pyramid(values: &[f32], width: usize, height: usize, channels: usize, levels: usize) -> Vec<PyramidLevel> {
    assert_eq!(values.len(), width * height * channels, "one value per pixel and channel");
    let mut out = vec![PyramidLevel { width, height, values: values.to_vec() }];
    while out.len() < levels {
        let last = &out[out.len() - 1];
        if last.width <= 1 && last.height <= 1 {
            break;
        }
        let next = halve(last, channels);
        out.push(next);
    }
    out
}

/// Adjoint of [`pyramid`]: cotangents of all its levels → ∂L/∂values.
///
/// # Panics
/// When the levels are not those of a pyramid.
pub fn pyramid_vjp(d_levels: &[PyramidLevel], channels: usize) -> Vec<f32> {
    let Some(last) = d_levels.last() else { return Vec::new() };
    let mut d = last.values.clone();
    for pair in d_levels.windows(2).rev() {
        let (fine, coarse) = (&pair[0], &pair[1]);
        let mut d_fine = fine.values.clone();
        let (row, cells) = (fine.width * channels, coarse.width * channels);
        for (pair, d) in d_fine.chunks_mut(2 * row).zip(d.chunks_exact(cells)) {
            let full = 0.5 / (pair.len() / row) as f32;
            for line in pair.chunks_exact_mut(row) {
                for (pixels, cell) in line.chunks_mut(2 * channels).zip(d.chunks_exact(channels)) {
                    let share = if pixels.len() == 2 * channels { full } else { 2.0 * full };
                    for pixel in pixels.chunks_exact_mut(channels) {
                        pixel.iter_mut().zip(cell).for_each(|(p, c)| *p += share * c);
                    }
                }
            }
        }
        d = d_fine;
    }
    d
}

fn halve(fine: &PyramidLevel, channels: usize) -> PyramidLevel {
    let (width, height) = (fine.width.div_ceil(2), fine.height.div_ceil(2));
    let mut values = vec![0.0; width * height * channels];
    let row = fine.width * channels;
    for (pair, out) in fine.values.chunks(2 * row).zip(values.chunks_exact_mut(width * channels)) {
        // The last row and column may stand alone.
        let full = 0.5 / (pair.len() / row) as f32;
        for line in pair.chunks_exact(row) {
            for (pixels, cell) in line.chunks(2 * channels).zip(out.chunks_exact_mut(channels)) {
                let share = if pixels.len() == 2 * channels { full } else { 2.0 * full };
                for pixel in pixels.chunks_exact(channels) {
                    cell.iter_mut().zip(pixel).for_each(|(c, p)| *c += share * p);
                }
            }
        }
    }
    PyramidLevel { width, height, values }
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::SplitMix64;

    #[test]
    fn the_adjoint_of_the_pyramid_is_its_transpose_and_means_are_kept() {
        let mut rng = SplitMix64(6);
        for (w, h, c) in [(16, 16, 1), (13, 7, 3), (1, 5, 2)] {
            let mut random = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.normal() as f32).collect() };
            let x = random(w * h * c);
            let levels = pyramid(&x, w, h, c, 9);
            let d: Vec<PyramidLevel> =
                levels.iter().map(|l| PyramidLevel { values: random(l.values.len()), ..l.clone() }).collect();
            let inner = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
            let forward: f64 = levels.iter().zip(&d).map(|(l, d)| inner(&l.values, &d.values)).sum();
            let backward = inner(&pyramid_vjp(&d, c), &x);
            println!("{w}x{h}x{c}: <Ax, d> = {forward:.6}, <x, A'd> = {backward:.6}");
            assert!((forward - backward).abs() < 1e-5 * forward.abs().max(1.0));
            assert_eq!((levels[levels.len() - 1].width, levels[levels.len() - 1].height), (1, 1));
        }
        let flat = pyramid(&[0.25; 13 * 7], 13, 7, 1, 9);
        assert!(flat.iter().all(|l| l.values.iter().all(|v| (v - 0.25).abs() < 1e-6)));
    }
}

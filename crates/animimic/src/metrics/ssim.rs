//! SSIM (Wang et al. 2004, eq. 13): Gaussian 11×11 window, σ 1.5, K₁ = 0.01, K₂ = 0.03, L = 1, population covariance;
//! per channel on sRGB-encoded values, mean over pixels at least 5 px from the border, then over channels.

use super::psnr::whole_and_box;
use super::{Evidence, Metric, Missing, Reading};
use animimic_scene::Image;

pub struct Ssim;

const SIGMA: f64 = 1.5;
/// Half width of the window: 11 = 2·5 + 1.
const RADIUS: usize = 5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

impl Metric for Ssim {
    fn name(&self) -> &'static str {
        "ssim"
    }

    fn definition(&self) -> &'static str {
        "Wang 2004: Gaussian 11×11, σ 1.5, K1 .01, K2 .03, L 1, population covariance, per channel then mean, 5 px border cropped; whole frame and object box"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let pictures = e.pictures.ok_or(Missing("needs a video"))?;
        let (whole, object) = whole_and_box(pictures, ssim);
        Ok(vec![("ssim".into(), whole), ("ssim_box".into(), object)])
    }
}

/// SSIM of two pictures of one size; 1 where the window does not fit.
fn ssim(a: &Image, b: &Image) -> f64 {
    if a.width <= 2 * RADIUS || a.height <= 2 * RADIUS {
        return 1.0;
    }
    (0..3).map(|c| ssim_of_channel(&plane(a, c), &plane(b, c), a.width, a.height)).sum::<f64>() / 3.0
}

fn plane(image: &Image, channel: usize) -> Vec<f64> {
    image.rgb.iter().map(|p| f64::from(p[channel]) / 255.0).collect()
}

fn ssim_of_channel(x: &[f64], y: &[f64], width: usize, height: usize) -> f64 {
    let product = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(p, q)| p * q).collect() };
    let mean = |values: &[f64]| windowed_mean(values, width, height);
    let (mx, my) = (mean(x), mean(y));
    let (xx, yy, xy) = (mean(&product(x, x)), mean(&product(y, y)), mean(&product(x, y)));
    let total: f64 = (0..mx.len())
        .map(|i| {
            let (vx, vy, cxy) = (xx[i] - mx[i] * mx[i], yy[i] - my[i] * my[i], xy[i] - mx[i] * my[i]);
            ((2.0 * mx[i] * my[i] + C1) * (2.0 * cxy + C2)) / ((mx[i] * mx[i] + my[i] * my[i] + C1) * (vx + vy + C2))
        })
        .sum();
    total / mx.len() as f64
}

/// Gaussian window mean at all pixels where the window fits: (height − 10) rows of (width − 10).
fn windowed_mean(values: &[f64], width: usize, height: usize) -> Vec<f64> {
    let weights: Vec<f64> =
        (0..=2 * RADIUS).map(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let (inner_w, inner_h) = (width - 2 * RADIUS, height - 2 * RADIUS);
    // One tap after the other over whole rows, so that the loops over x run in vector registers.
    let mut rows = vec![0.0; height * inner_w];
    for (row, source) in rows.chunks_exact_mut(inner_w).zip(values.chunks_exact(width)) {
        for (k, w) in weights.iter().enumerate() {
            row.iter_mut().zip(&source[k..]).for_each(|(out, v)| *out += w / sum * v);
        }
    }
    let mut out = vec![0.0; inner_h * inner_w];
    for (y, row) in out.chunks_exact_mut(inner_w).enumerate() {
        for (k, w) in weights.iter().enumerate() {
            let source = &rows[(y + k) * inner_w..(y + k + 1) * inner_w];
            row.iter_mut().zip(source).for_each(|(out, v)| *out += w / sum * v);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ssim_equals_scikit_images() {
        let (a, b) = super::super::psnr::tests::pair();
        let s = ssim(&a, &b);
        println!("{s}");
        assert!((s - SKIMAGE_SSIM).abs() < 1e-9);
    }

    /// `structural_similarity(a/255, b/255, channel_axis=2, gaussian_weights=True, sigma=1.5,
    /// use_sample_covariance=False, data_range=1)`, scikit-image 0.26.0.
    const SKIMAGE_SSIM: f64 = 0.900_662_588_179_138_8;

    #[test]
    fn a_picture_is_exactly_like_itself() {
        let (a, _) = super::super::psnr::tests::pair();
        assert!((ssim(&a, &a) - 1.0).abs() < 1e-12);
    }
}

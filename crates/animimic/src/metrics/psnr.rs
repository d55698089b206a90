//! PSNR = 10·log10(1 / MSE) on sRGB-encoded values in [0, 1]: whole frame, and inside the object's box.

use super::{Evidence, Metric, Missing, PicturePair, Reading, mean};
use animimic_scene::image::bounds;
use animimic_scene::{Image, Mask};
use std::ops::Range;

pub struct Psnr;

/// What identical pictures score [dB]: the infinity is capped so that means stay finite (8-bit pictures differ by 48 dB or less).
const CAP_DB: f64 = 100.0;

impl Metric for Psnr {
    fn name(&self) -> &'static str {
        "psnr"
    }

    fn definition(&self) -> &'static str {
        "10·log10(1/MSE) [dB] of sRGB-encoded values in [0, 1], mean over frames; whole frame and inside the object's bounding box"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let pictures = e.pictures.ok_or(Missing("needs a video"))?;
        let (whole, object) = whole_and_box(pictures, psnr);
        Ok(vec![("psnr_db".into(), whole), ("psnr_box_db".into(), object)])
    }
}

/// Mean over frames of a picture measure: of whole frames, and of the object's box.
pub(super) fn whole_and_box(p: &PicturePair, measure: impl Fn(&Image, &Image) -> f64 + Sync) -> (f64, f64) {
    use rayon::prelude::*;
    let per_frame: Vec<(f64, Option<f64>)> = (0..p.result.len().min(p.reference.len()))
        .into_par_iter()
        .map(|t| {
            let (a, b) = (&p.result[t], &p.reference[t]);
            let cut = |[columns, rows]: [Range<usize>; 2]| {
                measure(&a.cropped(columns.clone(), rows.clone()), &b.cropped(columns, rows))
            };
            let boxed = p.object.get(t).and_then(bounding_box).map(cut);
            (measure(a, b), boxed)
        })
        .collect();
    (mean(per_frame.iter().map(|f| f.0)), mean(per_frame.iter().filter_map(|f| f.1)))
}

/// Columns and rows of the pixels inside a mask, at least 11 pixels wide and high where the picture is.
fn bounding_box(mask: &Mask) -> Option<[Range<usize>; 2]> {
    const WINDOW: usize = 11; // SSIM's window must fit
    let widen = |r: Range<usize>, n: usize| {
        let lack = WINDOW.saturating_sub(r.len());
        r.start.saturating_sub(lack.div_ceil(2))..(r.end + lack).min(n)
    };
    let [columns, rows] = bounds(mask.width, mask.height, |x, y| mask.inside(x, y))?;
    Some([widen(columns, mask.width), widen(rows, mask.height)])
}

/// PSNR of two pictures of one size [dB], at most 100.
fn psnr(a: &Image, b: &Image) -> f64 {
    let squares: f64 = a
        .rgb
        .iter()
        .flatten()
        .zip(b.rgb.iter().flatten())
        .map(|(&x, &y)| ((f64::from(x) - f64::from(y)) / 255.0).powi(2))
        .sum();
    let mse = squares / (3 * a.rgb.len()).max(1) as f64;
    if mse == 0.0 { CAP_DB } else { (-10.0 * mse.log10()).min(CAP_DB) }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// The pictures on which scikit-image's values were taken: integer formulas, so that both sides make the same pixels.
    pub fn pair() -> (Image, Image) {
        let make = |shift: usize| {
            let rgb = (0..48 * 64)
                .map(|i| {
                    let (x, y) = (i % 64, i / 64);
                    let v = |c: usize| (((x + shift) * (3 + c) + y * (5 - c) + (x * y) / (4 + c)) % 256) as u8;
                    [v(0), v(1), v(2)]
                })
                .collect();
            Image { width: 64, height: 48, rgb }
        };
        (make(0), make(1))
    }

    #[test]
    fn psnr_equals_scikit_images() {
        let (a, b) = pair();
        let p = psnr(&a, &b);
        println!("{p}");
        assert!((p - SKIMAGE_PSNR).abs() < 1e-9);
    }

    /// `peak_signal_noise_ratio(a/255, b/255, data_range=1)`, scikit-image 0.26.0.
    const SKIMAGE_PSNR: f64 = 18.535_090_179_235_183;
}

//! Robust L1 of a residual picture over the levels of its pyramid.
//!
//! L = mean over levels k of 4ᵏ/N Σ_cells √(r² + ε²) − ε, r the mean residual of a cell of 2ᵏ × 2ᵏ pixels and N the divisor:
//! Charbonnier's smooth L1 (Charbonnier et al. 1994). A pyramid is linear, so that of the difference serves.

use super::Observed;
use animimic_render::{PyramidLevel, Raster, pyramid, pyramid_vjp};
use animimic_scene::image::bounds;

/// The part of the picture that losses look at: all that is drawn or observed, aligned to whole cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First column [px].
    pub x0: usize,
    /// First row [px].
    pub y0: usize,
    /// Width [px].
    pub width: usize,
    /// Height [px].
    pub height: usize,
}

/// Cells of the coarsest level have this side [px]; windows are aligned to it, so that cells do not depend on the window.
const ALIGNMENT: usize = 16;

impl Window {
    /// Around the drawn and the observed object, with a margin.
    pub fn around(raster: &Raster, seen: &Observed) -> Self {
        let (w, h) = (raster.width, raster.height);
        assert_eq!((seen.image.width, seen.image.height), (w, h), "the frame has the camera's size");
        let shown = |x: usize, y: usize| raster.covered(y * w + x) || seen.mask.coverage[y * w + x] > 0;
        let Some([columns, rows]) = bounds(w, h, shown) else {
            return Self { x0: 0, y0: 0, width: 0, height: 0 };
        };
        let low = |v: usize| v.saturating_sub(1) / ALIGNMENT * ALIGNMENT;
        let high = |v: usize, end: usize| ((v + 1).div_ceil(ALIGNMENT) * ALIGNMENT).min(end);
        let (x0, y0) = (low(columns.start), low(rows.start));
        Self { x0, y0, width: high(columns.end, w) - x0, height: high(rows.end, h) - y0 }
    }

    /// Picture pixels of the window, row by row.
    pub(super) fn pixels(self, picture_width: usize) -> impl Iterator<Item = usize> {
        (self.y0..self.y0 + self.height).flat_map(move |y| {
            let row = y * picture_width + self.x0;
            row..row + self.width
        })
    }
}

/// Which levels count, and how the residual is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Levels {
    /// Levels 1 to this one (at most 4).
    pub count: usize,
    /// ε: residuals well below it count squared, those above by their size.
    pub softness: f64,
}

impl Levels {
    /// The loss of a residual picture of `channels` interleaved values in a window, and its cotangent if `gradient`.
    pub(crate) fn loss(
        &self,
        residual: &[f32],
        window: Window,
        channels: usize,
        divisor: f64,
        gradient: bool,
    ) -> (f64, Vec<f32>) {
        let mut levels = pyramid(residual, window.width, window.height, channels, self.count.min(4) + 1);
        let used = (levels.len() - 1).max(1);
        let mut sum = 0.0;
        let softness = self.softness as f32;
        for (k, level) in levels.iter_mut().enumerate() {
            if k == 0 {
                level.values.fill(0.0);
                continue;
            }
            let scale = f64::from(1u32 << (2 * k)) / (divisor * (used * channels) as f64);
            sum += scale * charbonnier(level, softness, scale as f32);
        }
        (sum, if gradient { pyramid_vjp(&levels, channels) } else { Vec::new() })
    }
}

/// Σ √(r² + ε²) − ε; leaves `scale` times its derivative in the level.
fn charbonnier(level: &mut PyramidLevel, softness: f32, scale: f32) -> f64 {
    let mut sum = 0.0;
    for r in &mut level.values {
        let root = (*r * *r + softness * softness).sqrt();
        // = root − ε, without its cancellation.
        sum += f64::from(*r * *r / (root + softness));
        *r *= scale / root;
    }
    sum
}

//! Silhouette: the drawn coverage against the mask.

use super::{Adjoint, Levels, Observed, PictureLoss, Window};
use animimic_render::Rendered;

/// Robust mean L1 of coverages.
#[derive(Clone, Debug, PartialEq)]
pub struct MaskLoss(pub Levels);

/// Cells of 2, 4 and 8 pixels; residuals below 0.3 count squared: edges of masks are that uncertain.
impl Default for MaskLoss {
    fn default() -> Self {
        Self(Levels { count: 3, softness: 0.3 })
    }
}

impl PictureLoss for MaskLoss {
    fn name(&self) -> &'static str {
        "mask"
    }

    fn value(&self, drawn: &Rendered, seen: &Observed, window: Window, adjoint: Option<(&mut Adjoint, f64)>) -> f64 {
        let width = seen.image.width;
        let residual: Vec<f32> = window
            .pixels(width)
            .map(|p| f32::from(u8::from(drawn.raster.covered(p))) - f32::from(seen.mask.coverage[p]) / 255.0)
            .collect();
        let (value, d) = self.0.loss(&residual, window, 1, seen.divisor_px, adjoint.is_some());
        if let Some((adjoint, scale)) = adjoint {
            window.pixels(width).zip(d).for_each(|(p, d)| adjoint.mask[p] += scale as f32 * d);
        }
        value
    }
}

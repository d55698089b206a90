//! Colour: the rendering over the background against the frame.
//!
//! Residual: drawn colour − frame's colour, sRGB-encoded. Where neither the model is drawn nor the object observed it is zero by
//! construction ([`Observed::fill_background`]).

use super::{Adjoint, Levels, Observed, PictureLoss, Window};
use animimic_render::Rendered;

/// Robust mean L1 of colours.
#[derive(Clone, Debug, PartialEq)]
pub struct RgbLoss(pub Levels);

/// Cells of 2, 4 and 8 pixels; residuals below 0.05 count squared: compression and noise.
impl Default for RgbLoss {
    fn default() -> Self {
        Self(Levels { count: 3, softness: 0.05 })
    }
}

impl PictureLoss for RgbLoss {
    fn name(&self) -> &'static str {
        "rgb"
    }

    fn value(&self, drawn: &Rendered, seen: &Observed, window: Window, adjoint: Option<(&mut Adjoint, f64)>) -> f64 {
        let width = seen.image.width;
        let mut residual = Vec::with_capacity(3 * window.width * window.height);
        for p in window.pixels(width) {
            let (drawn, frame) = (drawn.rgb[p], seen.image.rgb[p]);
            residual.extend([0, 1, 2].map(|c| drawn[c] - f32::from(frame[c]) / 255.0));
        }
        let (value, d) = self.0.loss(&residual, window, 3, seen.divisor_px, adjoint.is_some());
        if let Some((adjoint, scale)) = adjoint {
            for (p, d) in window.pixels(width).zip(d.chunks_exact(3)) {
                (0..3).for_each(|c| adjoint.rgb[p][c] += scale as f32 * d[c]);
            }
        }
        value
    }
}

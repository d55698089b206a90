//! What a frame of the video shows, as rendered losses compare with it.

use super::Window;
use animimic_render::Rendered;
use animimic_scene::{Image, Mask};

/// One frame.
#[derive(Clone, Debug)]
pub struct Observed<'a> {
    /// Pixels.
    pub image: &'a Image,
    /// What is behind the object.
    pub background: &'a Image,
    /// Coverage of the object that a rendering should have.
    pub mask: Mask,
    /// Losses are sums over pixels divided by this [px].
    pub divisor_px: f64,
}

impl Observed<'_> {
    /// Puts behind the drawn model what the losses take to be there: the background where the video shows the object, and the
    /// frame itself where it does not, so that background is compared with itself and is no evidence of colour.
    pub fn fill_background(&self, drawn: &mut Rendered, window: Window) {
        for y in window.y0..window.y0 + window.height {
            let row = y * self.image.width;
            for p in row + window.x0..row + window.x0 + window.width {
                if drawn.raster.covered(p) {
                    continue;
                }
                let m = f32::from(self.mask.coverage[p]) / 255.0;
                let (frame, plate) = (self.image.rgb[p], self.background.rgb[p]);
                let mix = |c: usize| (f32::from(frame[c]) * (1.0 - m) + f32::from(plate[c]) * m) / 255.0;
                drawn.rgb[p] = [mix(0), mix(1), mix(2)];
            }
        }
    }
}

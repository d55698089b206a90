//! Luma images of f32 and their pyramids.

use animimic_scene::Image;

/// A luma image, 0–255, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gray {
    /// Width [px].
    pub width: usize,
    /// Height [px].
    pub height: usize,
    /// Luma of the sRGB-encoded pixels (BT.601 weights), `[y * width + x]`.
    pub values: Vec<f32>,
}

impl Gray {
    /// Luma of a colour image.
    pub fn from_image(image: &Image) -> Self {
        let luma = |&[r, g, b]: &[u8; 3]| 0.299 * f32::from(r) + 0.587 * f32::from(g) + 0.114 * f32::from(b);
        Self { width: image.width, height: image.height, values: image.rgb.iter().map(luma).collect() }
    }

    /// Half the size: means of 2×2 pixels (an odd last column or row is left out).
    pub fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            let top = &self.values[(2 * y).min(self.height - 1) * self.width..][..self.width];
            let bottom = &self.values[(2 * y + 1).min(self.height - 1) * self.width..][..self.width];
            for x in 0..width {
                let right = (2 * x + 1).min(self.width - 1);
                values.push(0.25 * (top[2 * x] + top[right] + bottom[2 * x] + bottom[right]));
            }
        }
        Self { width, height, values }
    }

    /// The image and its halvings, finest first, `levels` in all.
    pub fn pyramid(&self, levels: usize) -> Vec<Gray> {
        let mut pyramid = vec![self.clone()];
        while pyramid.len() < levels {
            let next = pyramid[pyramid.len() - 1].halved();
            pyramid.push(next);
        }
        pyramid
    }

    /// Bilinear value at a continuous position whose integers are pixel *centres* (index space), clamped at the border.
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let at = |x: usize, y: usize| self.values[y * self.width + x];
        let top = at(x0, y0) + fx * (at(x1, y0) - at(x0, y0));
        let bottom = at(x0, y1) + fx * (at(x1, y1) - at(x0, y1));
        top + fy * (bottom - top)
    }

    /// Central differences (d/dx, d/dy) with replicated borders.
    pub fn gradients(&self) -> (Vec<f32>, Vec<f32>) {
        let (w, h) = (self.width, self.height);
        let (mut gx, mut gy) = (vec![0.0; w * h], vec![0.0; w * h]);
        for y in 0..h {
            let row = &self.values[y * w..(y + 1) * w];
            let out = &mut gx[y * w..(y + 1) * w];
            for x in 1..w.saturating_sub(1) {
                out[x] = 0.5 * (row[x + 1] - row[x - 1]);
            }
            if w > 1 {
                out[0] = 0.5 * (row[1] - row[0]);
                out[w - 1] = 0.5 * (row[w - 1] - row[w - 2]);
            }
            let above = &self.values[y.saturating_sub(1) * w..][..w];
            let below = &self.values[(y + 1).min(h - 1) * w..][..w];
            for (out, (a, b)) in gy[y * w..(y + 1) * w].iter_mut().zip(above.iter().zip(below)) {
                *out = 0.5 * (b - a);
            }
        }
        (gx, gy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_has_its_slopes_as_gradients_and_keeps_them_scaled_when_halved() {
        let values = (0..12 * 8).map(|i| 3.0 * (i % 12) as f32 - 2.0 * (i / 12) as f32).collect();
        let plane = Gray { width: 12, height: 8, values };
        let (gx, gy) = plane.gradients();
        assert!((gx[3 * 12 + 5] - 3.0).abs() < 1e-6 && (gy[3 * 12 + 5] + 2.0).abs() < 1e-6);
        let half = plane.halved();
        // Centre of half-size pixel (2, 1) is full-size (4.5, 2.5).
        assert!((half.values[6 + 2] - plane.sample(4.5, 2.5)).abs() < 1e-4);
    }
}

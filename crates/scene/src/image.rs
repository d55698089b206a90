//! Pixels.

/// An 8-bit sRGB-encoded colour image, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Image {
    /// Width [px].
    pub width: usize,
    /// Height [px].
    pub height: usize,
    /// Pixels, `[y * width + x]`.
    pub rgb: Vec<[u8; 3]>,
}

impl Image {
    /// An image of one colour.
    pub fn filled(width: usize, height: usize, color: [u8; 3]) -> Self {
        Self { width, height, rgb: vec![color; width * height] }
    }

    /// The pixel at column `x`, row `y`.
    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        self.rgb[y * self.width + x]
    }

    /// The picture at another size by area averaging (shrinking) or repetition (enlarging).
    pub fn resized(&self, width: usize, height: usize) -> Self {
        Self { width, height, rgb: averages((self.width, self.height), (width, height), |i| self.rgb[i]) }
    }
}

/// Means, rounded, over the source pixels that each target pixel touches.
fn averages<const N: usize>(
    (from_w, from_h): (usize, usize),
    (w, h): (usize, usize),
    value: impl Fn(usize) -> [u8; N],
) -> Vec<[u8; N]> {
    let span = |i: usize, n: usize, m: usize| (i * m / n, ((i + 1) * m).div_ceil(n).max(i * m / n + 1).min(m));
    let mut out = Vec::with_capacity(w * h);
    for y in 0..h {
        let (y0, y1) = span(y, h, from_h);
        for x in 0..w {
            let (x0, x1) = span(x, w, from_w);
            let mut sum = [0u32; N];
            for v in y0..y1 {
                for u in x0..x1 {
                    sum.iter_mut().zip(value(v * from_w + u)).for_each(|(s, c)| *s += u32::from(c));
                }
            }
            let n = ((y1 - y0) * (x1 - x0)) as u32;
            out.push(sum.map(|s| ((s + n / 2) / n) as u8));
        }
    }
    out
}

/// Coverage of the object, 0 (background) to 255 (object), row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mask {
    /// Width [px].
    pub width: usize,
    /// Height [px].
    pub height: usize,
    /// Coverage, `[y * width + x]`.
    pub coverage: Vec<u8>,
}

impl Mask {
    /// Whether the pixel is more object than background.
    pub fn inside(&self, x: usize, y: usize) -> bool {
        self.coverage[y * self.width + x] >= 128
    }

    /// The mask at another size, as [`Image::resized`].
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let coverage = averages((self.width, self.height), (width, height), |i| [self.coverage[i]]);
        Self { width, height, coverage: coverage.into_iter().flatten().collect() }
    }

    /// Number of pixels inside.
    pub fn area(&self) -> usize {
        self.coverage.iter().filter(|&&c| c >= 128).count()
    }

    /// Intersection over union of the inside sets; 1 when both are empty.
    pub fn iou(&self, other: &Mask) -> f64 {
        let (mut both, mut any) = (0usize, 0usize);
        for (a, b) in self.coverage.iter().zip(&other.coverage) {
            both += usize::from(*a >= 128 && *b >= 128);
            any += usize::from(*a >= 128 || *b >= 128);
        }
        if any == 0 { 1.0 } else { both as f64 / any as f64 }
    }
}

/// sRGB-encoded value in \[0, 1\] → linear light (IEC 61966-2-1).
pub fn linear_from_srgb(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Linear light in \[0, 1\] → sRGB-encoded value.
pub fn srgb_from_linear(c: f32) -> f32 {
    if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

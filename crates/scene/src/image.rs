//! Pixels.

use std::ops::Range;

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

    /// A part of the picture.
    pub fn cropped(&self, columns: Range<usize>, rows: Range<usize>) -> Self {
        let row = |y: usize| &self.rgb[y * self.width..][columns.clone()];
        let rgb = rows.clone().flat_map(|y| row(y).iter().copied()).collect();
        Self { width: columns.len(), height: rows.len(), rgb }
    }

    /// The picture at another size by area averaging (shrinking) or repetition (enlarging).
    pub fn resized(&self, width: usize, height: usize) -> Self {
        Self { width, height, rgb: averages((self.width, self.height), (width, height), |i| self.rgb[i]) }
    }
}

/// Columns and rows that the pixels (x, y) that are `inside` span; `None` where there are none.
pub fn bounds(width: usize, height: usize, inside: impl Fn(usize, usize) -> bool) -> Option<[Range<usize>; 2]> {
    let mut found: Option<[Range<usize>; 2]> = None;
    for y in 0..height {
        let Some(first) = (0..width).find(|&x| inside(x, y)) else { continue };
        let end = (first..width).rev().find(|&x| inside(x, y)).unwrap_or(first) + 1;
        let [columns, rows] = found.get_or_insert([first..end, y..y]);
        *columns = columns.start.min(first)..columns.end.max(end);
        rows.end = y + 1;
    }
    found
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_inside_spans_its_bounds_and_is_cut_out_by_them() {
        let mut image = Image::filled(7, 5, [0; 3]);
        let spots = [(2, 1), (5, 1), (1, 3)];
        spots.iter().for_each(|&(x, y)| image.rgb[y * 7 + x] = [9; 3]);
        let [columns, rows] = bounds(7, 5, |x, y| image.at(x, y) != [0; 3]).expect("three spots");
        assert_eq!((columns.clone(), rows.clone()), (1..6, 1..4));
        let part = image.cropped(columns, rows);
        assert_eq!((part.width, part.height), (5, 3));
        assert!(spots.iter().all(|&(x, y)| part.at(x - 1, y - 1) == [9; 3]) && part.at(0, 0) == [0; 3]);
        assert_eq!(bounds(7, 5, |_, _| false), None);
        assert_eq!(bounds(7, 5, |x, y| (x, y) == (6, 4)), Some([6..7, 4..5]));
    }
}

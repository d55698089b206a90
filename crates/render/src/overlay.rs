//! Lines, discs, labels and blends on pictures: skeletons, tracks, contact sheets.

use crate::font::{GLYPH_SIZE, glyph};
use animimic_scene::{Image, Mask};
use glam::DVec2;

/// Draws an antialiased disc; `center` in pixels (centres at +0.5), `radius` [px], `opacity` in \[0, 1\].
pub fn disc(image: &mut Image, center: DVec2, radius: f64, color: [u8; 3], opacity: f64) {
    let reach = radius + 1.0;
    for_box(
        image,
        center - reach,
        center + reach,
        |p| (radius + 0.5 - p.distance(center)).clamp(0.0, 1.0) * opacity,
        color,
    );
}

/// Draws an antialiased line with round ends, `width` [px] wide.
pub fn line(image: &mut Image, a: DVec2, b: DVec2, width: f64, color: [u8; 3], opacity: f64) {
    let reach = 0.5 * width + 1.0;
    let d = b - a;
    let inv = 1.0 / d.length_squared().max(1e-12);
    for_box(
        image,
        a.min(b) - reach,
        a.max(b) + reach,
        |p| {
            let nearest = a + d * ((p - a).dot(d) * inv).clamp(0.0, 1.0);
            (0.5 * width + 0.5 - p.distance(nearest)).clamp(0.0, 1.0) * opacity
        },
        color,
    );
}

/// Draws `label` in an 8×8 bitmap font, `scale` times as large, its top left corner at (`x`, `y`) [px]. Characters that the
/// font lacks are drawn as a box.
pub fn text(image: &mut Image, x: usize, y: usize, label: &str, scale: usize, color: [u8; 3]) {
    let scale = scale.max(1);
    for (k, c) in label.chars().enumerate() {
        for (row, bits) in glyph(c).into_iter().enumerate() {
            for column in (0..GLYPH_SIZE).filter(|column| bits & (0x80 >> column) != 0) {
                let (x0, y0) = (x + (k * GLYPH_SIZE + column) * scale, y + row * scale);
                fill(image, x0, y0, scale, scale, color);
            }
        }
    }
}

/// Width and height of a label drawn by [`text`] [px].
pub fn text_size(label: &str, scale: usize) -> (usize, usize) {
    (label.chars().count() * GLYPH_SIZE * scale.max(1), GLYPH_SIZE * scale.max(1))
}

/// Fills a rectangle, cut to the picture.
pub fn fill(image: &mut Image, x: usize, y: usize, width: usize, height: usize, color: [u8; 3]) {
    for row in y.min(image.height)..(y + height).min(image.height) {
        let (from, to) = (x.min(image.width), (x + width).min(image.width));
        image.rgb[row * image.width + from..row * image.width + to].fill(color);
    }
}

/// Copies `source` into `image` with its top left corner at (`x`, `y`), cut to the picture.
pub fn paste(image: &mut Image, source: &Image, x: usize, y: usize) {
    let columns = source.width.min(image.width.saturating_sub(x));
    for row in 0..source.height.min(image.height.saturating_sub(y)) {
        let to = (y + row) * image.width + x;
        let from = row * source.width;
        image.rgb[to..to + columns].copy_from_slice(&source.rgb[from..from + columns]);
    }
}

/// Blends `over` onto `image` where `coverage` says, times `opacity`. Sizes must agree; otherwise nothing is drawn.
pub fn blend(image: &mut Image, over: &Image, coverage: &Mask, opacity: f64) {
    let size = (image.width, image.height);
    if (over.width, over.height) != size || (coverage.width, coverage.height) != size {
        return;
    }
    for ((out, &top), &c) in image.rgb.iter_mut().zip(&over.rgb).zip(&coverage.coverage) {
        *out = mix(*out, top, f64::from(c) / 255.0 * opacity);
    }
}

/// Draws the border of a mask (pixels inside with a neighbour outside).
pub fn contour(image: &mut Image, mask: &Mask, color: [u8; 3]) {
    let (w, h) = (mask.width, mask.height);
    if (image.width, image.height) != (w, h) {
        return;
    }
    for y in 0..h {
        for x in 0..w {
            let edge = (x > 0 && !mask.inside(x - 1, y))
                || (x + 1 < w && !mask.inside(x + 1, y))
                || (y > 0 && !mask.inside(x, y - 1))
                || (y + 1 < h && !mask.inside(x, y + 1));
            if mask.inside(x, y) && edge {
                image.rgb[y * w + x] = color;
            }
        }
    }
}

fn for_box(image: &mut Image, lo: DVec2, hi: DVec2, coverage: impl Fn(DVec2) -> f64, color: [u8; 3]) {
    // Casts saturate: coordinates that are not finite or far outside draw nothing or end at the border.
    if !(lo.is_finite() && hi.is_finite()) {
        return;
    }
    let (x0, y0) = (lo.x.max(0.0) as usize, lo.y.max(0.0) as usize);
    let (x1, y1) = ((hi.x.max(0.0) as usize + 1).min(image.width), (hi.y.max(0.0) as usize + 1).min(image.height));
    for y in y0..y1 {
        for x in x0..x1 {
            let c = coverage(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            if c > 0.0 {
                let pixel = &mut image.rgb[y * image.width + x];
                *pixel = mix(*pixel, color, c);
            }
        }
    }
}

fn mix(below: [u8; 3], above: [u8; 3], share: f64) -> [u8; 3] {
    [0, 1, 2].map(|c| (f64::from(below[c]) * (1.0 - share) + f64::from(above[c]) * share).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_has_its_area_and_everything_may_leave_the_picture() {
        let mut image = Image::filled(64, 48, [0; 3]);
        disc(&mut image, DVec2::new(30.0, 20.0), 8.0, [255; 3], 1.0);
        let area: f64 = image.rgb.iter().map(|p| f64::from(p[0]) / 255.0).sum();
        println!("area {area:.1}");
        assert!((area / (std::f64::consts::PI * 64.0) - 1.0).abs() < 0.02);
        line(&mut image, DVec2::new(-1e9, 3.0), DVec2::new(1e9, 40.0), 3.0, [255, 0, 0], 1.0);
        line(&mut image, DVec2::NAN, DVec2::ONE, 3.0, [255, 0, 0], 1.0);
        text(&mut image, 50, 45, "Label 42", 2, [0, 255, 0]);
        paste(&mut image, &Image::filled(20, 20, [9; 3]), 60, 40);
        assert_eq!(image.at(63, 47), [9; 3]);
    }

    #[test]
    fn every_letter_digit_and_common_sign_has_a_glyph_of_its_own() {
        let known: Vec<char> = (' '..='~').collect();
        let glyphs: std::collections::BTreeSet<[u8; GLYPH_SIZE]> = known.iter().map(|&c| glyph(c)).collect();
        assert_eq!(glyphs.len(), known.len());
    }
}

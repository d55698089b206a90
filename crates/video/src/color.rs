//! YCbCr ↔ RGB as ITU-T H.273 defines it: R'G'B' = f(Y', Cb, Cr; Kr, Kb, range), 4:2:0 chroma sited left (MPEG-2).

use animimic_scene::Image;
use rusty_h264::YuvFrame;

/// Matrix coefficients and range of a YCbCr signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColorSpace {
    /// Weight of red in luma.
    pub kr: f32,
    /// Weight of blue in luma.
    pub kb: f32,
    /// 0–255 (true) or 16–235 / 16–240 (false).
    pub full_range: bool,
}

impl ColorSpace {
    /// ITU-R BT.601, limited range. What decoders assume for streams that do not say.
    pub const BT601: Self = Self { kr: 0.299, kb: 0.114, full_range: false };
    /// ITU-R BT.709, limited range. What we write.
    pub const BT709: Self = Self { kr: 0.2126, kb: 0.0722, full_range: false };

    /// From H.273 `matrix_coefficients`; `None` for codes that are not a plain Kr/Kb matrix (RGB, YCgCo, …).
    pub fn from_matrix_coefficients(code: u8, full_range: bool) -> Option<Self> {
        let base = match code {
            1 => Self::BT709,
            2 | 5 | 6 => Self::BT601,
            4 => Self { kr: 0.30, kb: 0.11, full_range },
            7 => Self { kr: 0.212, kb: 0.087, full_range },
            9 => Self { kr: 0.2627, kb: 0.0593, full_range },
            _ => return None,
        };
        Some(Self { full_range, ..base })
    }
}

/// Decoded picture → RGB, chroma interpolated linearly at its true (left-sited) position.
pub fn rgb_from_yuv(frame: &YuvFrame, space: ColorSpace) -> Image {
    let (w, h) = (frame.width, frame.height);
    let (cw, ch) = (frame.chroma_width(), frame.chroma_height());
    let kg = 1.0 - space.kr - space.kb;
    let (y_gain, y_offset, c_gain) =
        if space.full_range { (1.0, 0.0, 1.0) } else { (255.0 / 219.0, 16.0, 255.0 / 224.0) };
    let red_from_cr = 2.0 * (1.0 - space.kr) * c_gain;
    let blue_from_cb = 2.0 * (1.0 - space.kb) * c_gain;
    let green_from_cr = -red_from_cr * space.kr / kg;
    let green_from_cb = -blue_from_cb * space.kb / kg;
    let mut image = Image::filled(w, h, [0; 3]);
    let (mut cb_row, mut cr_row) = (vec![0.0f32; cw], vec![0.0f32; cw]);
    for y in 0..h {
        // Chroma rows lie midway between luma rows: weights 3/4 and 1/4.
        let near = (y / 2).min(ch - 1);
        let far = if y % 2 == 0 { near.saturating_sub(1) } else { (near + 1).min(ch - 1) };
        for x in 0..cw {
            cb_row[x] = 0.75 * f32::from(frame.u[near * cw + x]) + 0.25 * f32::from(frame.u[far * cw + x]) - 128.0;
            cr_row[x] = 0.75 * f32::from(frame.v[near * cw + x]) + 0.25 * f32::from(frame.v[far * cw + x]) - 128.0;
        }
        let luma = &frame.y[y * w..(y + 1) * w];
        for (x, out) in image.rgb[y * w..(y + 1) * w].iter_mut().enumerate() {
            let c0 = (x / 2).min(cw - 1);
            let c1 = if x % 2 == 0 { c0 } else { (c0 + 1).min(cw - 1) };
            let cb = 0.5 * (cb_row[c0] + cb_row[c1]);
            let cr = 0.5 * (cr_row[c0] + cr_row[c1]);
            let l = (f32::from(luma[x]) - y_offset) * y_gain;
            *out = [l + red_from_cr * cr, l + green_from_cb * cb + green_from_cr * cr, l + blue_from_cb * cb]
                .map(|v| (v + 0.5).clamp(0.0, 255.0) as u8);
        }
    }
    image
}

/// RGB → 4:2:0 YCbCr of even size; an odd last column or row is repeated.
pub fn yuv_from_rgb(image: &Image, space: ColorSpace) -> YuvFrame {
    let (w, h) = (image.width.next_multiple_of(2), image.height.next_multiple_of(2));
    let kg = 1.0 - space.kr - space.kb;
    let (y_gain, y_offset, c_gain) =
        if space.full_range { (1.0, 0.0, 1.0) } else { (219.0 / 255.0, 16.0, 224.0 / 255.0) };
    let rgb = |x: usize, y: usize| image.at(x.min(image.width - 1), y.min(image.height - 1)).map(f32::from);
    let byte = |v: f32| (v + 0.5).clamp(0.0, 255.0) as u8;
    let luma = |[r, g, b]: [f32; 3]| space.kr * r + kg * g + space.kb * b;
    let mut frame = YuvFrame::black(w, h);
    for y in 0..h {
        for x in 0..w {
            frame.y[y * w + x] = byte(luma(rgb(x, y)) * y_gain + y_offset);
        }
    }
    let (cw, ch) = (frame.chroma_width(), frame.chroma_height());
    for cy in 0..ch {
        for cx in 0..cw {
            // Left-sited: horizontal filter 1 2 1 about column 2·cx, vertical mean of two rows.
            let mut sum = [0.0f32; 3];
            for (dx, weight) in [(-1i64, 0.125f32), (0, 0.25), (1, 0.125)] {
                let x = (2 * cx as i64 + dx).max(0) as usize;
                for y in [2 * cy, 2 * cy + 1] {
                    let p = rgb(x, y);
                    for k in 0..3 {
                        sum[k] += weight * p[k];
                    }
                }
            }
            let l = luma(sum);
            frame.u[cy * cw + cx] = byte((sum[2] - l) / (2.0 * (1.0 - space.kb)) * c_gain + 128.0);
            frame.v[cy * cw + cx] = byte((sum[0] - l) / (2.0 * (1.0 - space.kr)) * c_gain + 128.0);
        }
    }
    frame
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_colors_survive_the_round_trip_in_every_color_space() {
        let mut worst = 0;
        for space in [ColorSpace::BT601, ColorSpace::BT709, ColorSpace { full_range: true, ..ColorSpace::BT709 }] {
            for color in [[0, 0, 0], [255; 3], [217; 3], [255, 0, 0], [0, 255, 0], [0, 0, 255], [200, 120, 40]] {
                let image = Image::filled(7, 5, color);
                let back = rgb_from_yuv(&yuv_from_rgb(&image, space), space);
                assert_eq!((back.width, back.height), (8, 6));
                for k in 0..3 {
                    worst = worst.max(back.at(3, 3)[k].abs_diff(color[k]));
                }
            }
        }
        println!("worst difference {worst}");
        assert!(worst <= 2);
    }

    #[test]
    fn a_horizontal_color_ramp_is_not_shifted_by_chroma_subsampling() {
        let mut image = Image::filled(64, 8, [0; 3]);
        for y in 0..8 {
            for x in 0..64 {
                image.rgb[y * 64 + x] = [(4 * x) as u8, 128, (255 - 4 * x) as u8];
            }
        }
        let back = rgb_from_yuv(&yuv_from_rgb(&image, ColorSpace::BT709), ColorSpace::BT709);
        let worst = (2..62).map(|x| back.at(x, 4)[0].abs_diff(image.at(x, 4)[0])).max().expect("columns");
        println!("worst difference {worst}");
        assert!(worst <= 2, "a shift by half a pixel would show as 2 levels plus rounding");
    }
}

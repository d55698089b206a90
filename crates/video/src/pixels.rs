//! Between the `image` crate and our pixels; shrinking.

use crate::error::{Result, VideoError};
use crate::source::Picture;
use animimic_scene::{Image, Mask};
use std::path::Path;

/// Largest picture side [px] and largest decoded picture [bytes] that are accepted.
const MAX_SIDE: u32 = 16_384;
const MAX_BYTES: u64 = 1 << 30;

/// Limits for all picture decoders.
pub fn limits() -> image::Limits {
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_BYTES);
    limits
}

/// Decodes a picture file by its content.
pub fn open_image(file: &Path) -> Result<image::DynamicImage> {
    let mut reader = image::ImageReader::open(file)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(VideoError::io(file))?;
    reader.limits(limits());
    reader.decode().map_err(|e| VideoError::invalid(file, format!("not a readable picture: {e}")))
}

/// Reads a colour picture; alpha is dropped.
pub fn read_image(file: &Path) -> Result<Image> {
    Ok(picture_from_image(open_image(file)?).image)
}

/// Splits a decoded picture into colour and, where it has an alpha channel, coverage.
pub fn picture_from_image(image: image::DynamicImage) -> Picture {
    if !image.color().has_alpha() {
        let rgb = image.into_rgb8();
        let (width, height) = (rgb.width() as usize, rgb.height() as usize);
        return Picture { image: Image { width, height, rgb: rgb.pixels().map(|p| p.0).collect() }, alpha: None };
    }
    let rgba = image.into_rgba8();
    let (width, height) = (rgba.width() as usize, rgba.height() as usize);
    Picture {
        image: Image { width, height, rgb: rgba.pixels().map(|p| [p.0[0], p.0[1], p.0[2]]).collect() },
        alpha: Some(Mask { width, height, coverage: rgba.pixels().map(|p| p.0[3]).collect() }),
    }
}

/// Weights of the source cells that each target cell covers, in one dimension: (first source cell, weights summing to 1).
fn area_weights(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let scale = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            let (start, end) = (i as f64 * scale, ((i + 1) as f64 * scale).min(from as f64));
            let first = start.floor() as usize;
            let last = (end.ceil() as usize).clamp(first + 1, from);
            let weights = (first..last)
                .map(|s| (((s as f64 + 1.0).min(end) - (s as f64).max(start)) / (end - start)) as f32)
                .collect();
            (first, weights)
        })
        .collect()
}

/// Shrinks interleaved channels by exact area averages.
fn shrink_channels<const N: usize>(pixels: &[[u8; N]], size: (usize, usize), to: (usize, usize)) -> Vec<[u8; N]> {
    let columns = area_weights(size.0, to.0);
    let rows = area_weights(size.1, to.1);
    let mut narrow = vec![[0.0f32; N]; to.0 * size.1];
    for y in 0..size.1 {
        let line = &pixels[y * size.0..(y + 1) * size.0];
        for (out, (first, weights)) in narrow[y * to.0..(y + 1) * to.0].iter_mut().zip(&columns) {
            for (w, p) in weights.iter().zip(&line[*first..]) {
                for k in 0..N {
                    out[k] += w * f32::from(p[k]);
                }
            }
        }
    }
    let mut out = Vec::with_capacity(to.0 * to.1);
    for (first, weights) in &rows {
        for x in 0..to.0 {
            let mut sum = [0.5f32; N];
            for (i, w) in weights.iter().enumerate() {
                let p = narrow[(first + i) * to.0 + x];
                for k in 0..N {
                    sum[k] += w * p[k];
                }
            }
            out.push(sum.map(|v| v as u8));
        }
    }
    out
}

/// The size of a picture at a working height, aspect kept; never larger than the original.
pub fn working_size(size: (usize, usize), working_height: Option<usize>) -> (usize, usize) {
    match working_height {
        Some(h) if h > 0 && h < size.1 => (((size.0 * h) as f64 / size.1 as f64).round().max(1.0) as usize, h),
        _ => size,
    }
}

/// Shrinks a picture to `to` by area averaging.
pub fn shrink(picture: Picture, to: (usize, usize)) -> Picture {
    let size = (picture.image.width, picture.image.height);
    if size == to {
        return picture;
    }
    let image = Image { width: to.0, height: to.1, rgb: shrink_channels(&picture.image.rgb, size, to) };
    let alpha = picture.alpha.map(|a| {
        let coverage: Vec<[u8; 1]> = a.coverage.iter().map(|&c| [c]).collect();
        let coverage = shrink_channels(&coverage, size, to).into_iter().map(|[c]| c).collect();
        Mask { width: to.0, height: to.1, coverage }
    });
    Picture { image, alpha }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinking_keeps_the_mean_and_the_position_of_an_edge() {
        let mut image = Image::filled(30, 20, [0; 3]);
        for y in 0..20 {
            for x in 12..30 {
                image.rgb[y * 30 + x] = [200, 100, 50];
            }
        }
        let small = shrink(Picture { image, alpha: None }, (10, 7)).image;
        let reds: Vec<u8> = (0..10).map(|x| small.at(x, 3)[0]).collect();
        println!("{reds:?}");
        assert_eq!(reds, [0, 0, 0, 0, 200, 200, 200, 200, 200, 200]);
    }
}

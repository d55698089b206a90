//! Decoding of PNG, JPEG and WebP textures, with limits.

use crate::Image;
use std::io::Cursor;

/// Longest side of a texture that is decoded [px]; larger ones pass through undecoded.
const MAX_SIDE: u32 = 8192;
/// Memory a decoder may take [bytes].
const MAX_BYTES: u64 = 512 << 20;

/// Decodes a picture to sRGB bytes and its alpha (empty when all opaque).
///
/// # Errors
/// One clause saying why it could not be decoded.
pub fn decode(bytes: &[u8]) -> Result<(Image, Vec<u8>), String> {
    let reader = image::ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    if reader.format().is_none() {
        return Err("is neither PNG, JPEG nor WebP".into());
    }
    let size = image::ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let (width, height) = size.into_dimensions().map_err(|e| format!("cannot be decoded: {e}"))?;
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(format!("is {width}×{height} pixels, more than the {MAX_SIDE}×{MAX_SIDE} that are decoded"));
    }
    let mut reader = reader;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| format!("cannot be decoded: {e}"))?;
    if !decoded.color().has_alpha() {
        let rgb = decoded.into_rgb8();
        let pixels = rgb.pixels().map(|p| p.0).collect();
        return Ok((Image { width: rgb.width() as usize, height: rgb.height() as usize, rgb: pixels }, Vec::new()));
    }
    let rgba = decoded.into_rgba8();
    let rgb = rgba.pixels().map(|p| [p.0[0], p.0[1], p.0[2]]).collect();
    let mut alpha: Vec<u8> = rgba.pixels().map(|p| p.0[3]).collect();
    if alpha.iter().all(|&a| a == 255) {
        alpha = Vec::new();
    }
    Ok((Image { width: rgba.width() as usize, height: rgba.height() as usize, rgb }, alpha))
}

/// A PNG of a picture; `alpha` empty means opaque.
///
/// # Errors
/// One clause saying why it could not be encoded.
pub fn encode_png(image: &Image, alpha: &[u8]) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut out);
    let (width, height) = (image.width as u32, image.height as u32);
    let (bytes, kind): (Vec<u8>, _) = if alpha.is_empty() {
        (image.rgb.concat(), image::ExtendedColorType::Rgb8)
    } else {
        let rgba = image.rgb.iter().zip(alpha).flat_map(|(c, &a)| [c[0], c[1], c[2], a]);
        (rgba.collect(), image::ExtendedColorType::Rgba8)
    };
    image::ImageEncoder::write_image(encoder, &bytes, width, height, kind).map_err(|e| e.to_string())?;
    Ok(out)
}

//! Writing videos and pictures: H.264 MP4, GIF, PNG. Files appear whole or not at all.

use crate::color::{ColorSpace, yuv_from_rgb};
use crate::error::{Result, VideoError};
use crate::h264::{annex_b_nals, with_bt709_vui};
use animimic_scene::io::{SceneError, write_atomically};
use animimic_scene::{Image, Mask};
use muxide::api::{MuxerBuilder, VideoCodec};
use rusty_h264::{Encoder, EncoderConfig, NalUnit, NalUnitType, Preset, Profile};
use std::io::Write;
use std::path::Path;

/// Quantiser: about 42 dB on textured renders, so that our own compression never limits what is seen.
const QP: u8 = 20;
/// Frames between key frames, for scrubbing in editors.
const KEY_INTERVAL: u32 = 24;

/// Writes frames as H.264 High, 4:2:0, BT.709, index first ("fast start"); same frames, same bytes.
///
/// Odd sizes are padded to even ones by repeating the last column or row.
/// Errors: no frames, frames of different sizes, a frame rate that is not positive, or the disk.
pub fn write_mp4(path: &Path, frames: &mut dyn Iterator<Item = Image>, fps: f64) -> Result<()> {
    let mut frames = frames.peekable();
    frames.peek().ok_or_else(|| no_frames(path))?;
    write_whole(path, &encode_mp4(&mut frames, fps)?)
}

/// The bytes of such a video.
///
/// Errors: as [`write_mp4`], but for the disk.
pub fn encode_mp4(frames: &mut dyn Iterator<Item = Image>, fps: f64) -> Result<Vec<u8>> {
    check_fps(fps)?;
    let mut frames = frames.peekable();
    let size = frames.peek().map(|f| (f.width, f.height));
    let (width, height) = size.ok_or_else(|| VideoError::Caller("no frames to encode".into()))?;
    let (even_w, even_h) = (width.next_multiple_of(2), height.next_multiple_of(2));
    let mut encoder = Encoder::new(encoder_config(even_w, even_h, fps))
        .map_err(|e| VideoError::Caller(format!("cannot encode {width}×{height} pixels: {e:?}")))?;
    let mut file = Vec::new();
    let muxed = |e: muxide::api::MuxerError| VideoError::Caller(format!("cannot write the MP4: {e}"));
    let mut muxer = MuxerBuilder::new(&mut file)
        .video(VideoCodec::H264, even_w as u32, even_h as u32, fps)
        .with_fast_start(true)
        .build()
        .map_err(muxed)?;
    for (t, image) in frames.enumerate() {
        check_size(&image, t, (width, height))?;
        let unit = encoder
            .try_encode(&yuv_from_rgb(&image, ColorSpace::BT709))
            .map_err(|e| VideoError::Caller(format!("cannot encode frame {t}: {e:?}")))?;
        let (unit, is_key) = with_color_description(&unit);
        muxer.write_video(t as f64 / fps, &unit, is_key).map_err(muxed)?;
    }
    muxer.finish().map_err(muxed)?;
    Ok(file)
}

fn encoder_config(width: usize, height: usize, fps: f64) -> EncoderConfig {
    let mut config = EncoderConfig::baseline(width, height);
    // Look-ahead tools stay off: they delay frames, and the first ones come back empty.
    config.profile = Profile::High;
    config.cabac = true;
    config.preset = Preset::Balanced;
    config.gop_size = KEY_INTERVAL;
    config.min_keyint = KEY_INTERVAL;
    config.qp = QP;
    config.framerate = fps as f32;
    config
}

/// The access unit with our colour description in its SPS, and whether it is a key frame.
fn with_color_description(unit: &[u8]) -> (Vec<u8>, bool) {
    let (mut out, mut is_key) = (Vec::with_capacity(unit.len() + 32), false);
    for nal in annex_b_nals(unit) {
        let Some(&header) = nal.first() else { continue };
        is_key |= header & 31 == 5;
        if header & 31 == 7 {
            let sps = NalUnit::new(3, NalUnitType::Sps, with_bt709_vui(&crate::h264::rbsp(&nal[1..])));
            sps.write_annex_b(&mut out);
        } else {
            out.extend_from_slice(&[0, 0, 0, 1]);
            out.extend_from_slice(nal);
        }
    }
    (out, is_key)
}

/// Writes frames as an endlessly repeating GIF (256 colours a frame).
pub fn write_gif(path: &Path, frames: &mut dyn Iterator<Item = Image>, fps: f64) -> Result<()> {
    let mut frames = frames.peekable();
    frames.peek().ok_or_else(|| no_frames(path))?;
    write_whole(path, &encode_gif(&mut frames, fps)?)
}

/// The bytes of such a GIF.
///
/// Errors: as [`write_gif`], but for the disk.
pub fn encode_gif(frames: &mut dyn Iterator<Item = Image>, fps: f64) -> Result<Vec<u8>> {
    check_fps(fps)?;
    let mut data = Vec::new();
    let failed = |e: image::ImageError| VideoError::Caller(format!("cannot write the GIF: {e}"));
    {
        let mut encoder = image::codecs::gif::GifEncoder::new_with_speed(&mut data, 10);
        encoder.set_repeat(image::codecs::gif::Repeat::Infinite).map_err(failed)?;
        let mut first_size = None;
        for (t, image) in frames.enumerate() {
            check_size(&image, t, *first_size.get_or_insert((image.width, image.height)))?;
            let rgba = image.rgb.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect();
            let buffer = image::RgbaImage::from_raw(image.width as u32, image.height as u32, rgba)
                .ok_or_else(|| VideoError::Caller(format!("frame {t} has fewer pixels than its size says")))?;
            // GIF counts hundredths of a second: rounding the running time keeps the total right.
            let at = |k: usize| (100.0 * k as f64 / fps).round() as u32;
            let delay = image::Delay::from_numer_denom_ms(10 * (at(t + 1) - at(t)), 1);
            encoder.encode_frame(image::Frame::from_parts(buffer, 0, 0, delay)).map_err(failed)?;
        }
        if first_size.is_none() {
            return Err(VideoError::Caller("no frames to encode".into()));
        }
    }
    Ok(data)
}

/// Writes one picture as PNG.
pub fn write_png(path: &Path, image: &Image) -> Result<()> {
    write_whole(path, &encode_png(image)?)
}

/// The bytes of such a picture.
///
/// Errors: a picture without pixels.
pub fn encode_png(image: &Image) -> Result<Vec<u8>> {
    encode_samples(image.rgb.as_flattened(), image.width, image.height, image::ExtendedColorType::Rgb8)
}

/// Writes one mask as an 8-bit grey PNG.
pub fn write_mask_png(path: &Path, mask: &Mask) -> Result<()> {
    write_whole(path, &encode_samples(&mask.coverage, mask.width, mask.height, image::ExtendedColorType::L8)?)
}

/// PNG bytes of raw samples (big-endian for 16 bits).
pub(crate) fn encode_samples(
    samples: &[u8],
    width: usize,
    height: usize,
    kind: image::ExtendedColorType,
) -> Result<Vec<u8>> {
    use image::ImageEncoder;
    let mut data = Vec::new();
    image::codecs::png::PngEncoder::new(&mut data)
        .write_image(samples, width as u32, height as u32, kind)
        .map_err(|e| VideoError::Caller(format!("cannot encode a {width}×{height} PNG: {e}")))?;
    Ok(data)
}

/// Writes beside the target, then renames: a reader never sees half a file.
pub fn write_whole(path: &Path, data: &[u8]) -> Result<()> {
    write_atomically(path, |w| w.write_all(data)).map_err(|e| match e {
        SceneError::Io { source, .. } => VideoError::Io { path: path.into(), error: source },
        other => VideoError::Caller(other.to_string()),
    })
}

fn no_frames(path: &Path) -> VideoError {
    VideoError::Caller(format!("no frames to write to {}", path.display()))
}

fn check_fps(fps: f64) -> Result<()> {
    if fps.is_finite() && fps > 0.0 && fps <= 1000.0 {
        return Ok(());
    }
    Err(VideoError::Caller(format!("the frame rate must be in (0, 1000], not {fps}")))
}

fn check_size(image: &Image, t: usize, (width, height): (usize, usize)) -> Result<()> {
    if (image.width, image.height) == (width, height) && image.rgb.len() == width * height && width * height > 0 {
        return Ok(());
    }
    let found = format!("{}×{}", image.width, image.height);
    Err(VideoError::Caller(format!("frame {t} has {found} pixels where {width}×{height} are needed")))
}

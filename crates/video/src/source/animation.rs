//! GIF and animated WebP, with their own frame delays and alpha.

use super::{Decoded, Opened, Picture, Source};
use crate::error::{Result, VideoError};
use crate::pixels::{limits, picture_from_image};
use crate::quiet::catch_quietly;
use image::{AnimationDecoder, ImageDecoder};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Delay of frames that state none [s], as browsers show them.
const DEFAULT_DELAY_SECS: f64 = 0.1;
/// Total decoded size that is accepted [bytes].
const MAX_DECODED_BYTES: usize = 4 << 30;

/// Animated GIF.
pub struct Gif;
/// Animated WebP.
pub struct Webp;

impl Source for Gif {
    fn name(&self) -> &'static str {
        "GIF"
    }

    fn accepts(&self, _path: &Path, head: &[u8]) -> bool {
        head.starts_with(b"GIF8")
    }

    fn open(&self, path: &Path) -> Result<Box<dyn Opened>> {
        open(path, |data| {
            let mut decoder = image::codecs::gif::GifDecoder::new(data)?;
            decoder.set_limits(limits())?;
            Ok(decoder.into_frames())
        })
    }
}

impl Source for Webp {
    fn name(&self) -> &'static str {
        "animated WebP"
    }

    fn accepts(&self, _path: &Path, head: &[u8]) -> bool {
        head.starts_with(b"RIFF") && head.get(8..12) == Some(b"WEBP")
    }

    fn open(&self, path: &Path) -> Result<Box<dyn Opened>> {
        open(path, |data| {
            let mut decoder = image::codecs::webp::WebPDecoder::new(data)?;
            decoder.set_limits(limits())?;
            Ok(decoder.into_frames())
        })
    }
}

struct Animation {
    path: PathBuf,
    frames: Vec<image::RgbaImage>,
    times_secs: Vec<f64>,
    opaque: bool,
    warnings: Vec<String>,
}

fn open(
    path: &Path,
    decoder: impl FnOnce(Cursor<Vec<u8>>) -> image::ImageResult<image::Frames<'static>> + std::panic::UnwindSafe,
) -> Result<Box<dyn Opened>> {
    let data = std::fs::read(path).map_err(VideoError::io(path))?;
    let broken = |e: String| VideoError::invalid(path, format!("broken animation: {e}"));
    let collected = catch_quietly(move || -> image::ImageResult<_> {
        let (mut frames, mut times_secs, mut t, mut bytes) = (Vec::new(), Vec::new(), 0.0, 0);
        let mut fault = None;
        for frame in decoder(Cursor::new(data))? {
            let frame = match frame {
                Ok(frame) => frame,
                Err(e) => {
                    fault = Some(e.to_string());
                    break;
                }
            };
            let (numerator, denominator) = frame.delay().numer_denom_ms();
            let delay = f64::from(numerator) / f64::from(denominator.max(1)) / 1000.0;
            times_secs.push(t);
            t += if delay < 0.015 { DEFAULT_DELAY_SECS } else { delay };
            bytes += frame.buffer().len();
            frames.push(frame.into_buffer());
            if bytes > MAX_DECODED_BYTES {
                fault = Some(format!("more than {MAX_DECODED_BYTES} bytes of pixels"));
                break;
            }
        }
        Ok((frames, times_secs, fault))
    });
    let (frames, times_secs, fault) =
        collected.map_err(|()| broken("the decoder gave up".into()))?.map_err(|e| broken(e.to_string()))?;
    if frames.is_empty() {
        return Err(broken(fault.unwrap_or_else(|| "it holds no frames".into())));
    }
    let warnings =
        fault.map(|f| format!("the animation breaks off after {} frames: {f}", frames.len())).into_iter().collect();
    let opaque = frames.iter().all(|f: &image::RgbaImage| f.pixels().all(|p| p.0[3] == 255));
    Ok(Box::new(Animation { path: path.into(), frames, times_secs, opaque, warnings }))
}

impl Opened for Animation {
    fn times_secs(&self) -> &[f64] {
        &self.times_secs
    }

    fn size(&self) -> (usize, usize) {
        (self.frames[0].width() as usize, self.frames[0].height() as usize)
    }

    fn decode(
        &self,
        wanted: &dyn Fn(usize) -> bool,
        finish: &(dyn Fn(Picture) -> Picture + Sync),
        sink: &mut dyn FnMut(usize, Picture),
    ) -> Result<Decoded> {
        for (i, frame) in self.frames.iter().enumerate().filter(|(i, _)| wanted(*i)) {
            if (frame.width() as usize, frame.height() as usize) != self.size() {
                return Err(VideoError::invalid(&self.path, format!("frame {i} has another size than frame 0")));
            }
            let mut picture = picture_from_image(image::DynamicImage::ImageRgba8(frame.clone()));
            if self.opaque {
                picture.alpha = None;
            }
            sink(i, finish(picture));
        }
        Ok(Decoded { sound: self.frames.len(), promised: self.frames.len(), warnings: self.warnings.clone() })
    }
}

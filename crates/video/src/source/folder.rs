//! A folder of PNG, JPEG or WebP frames, in natural order of their names (frame2 before frame10).

use super::{Decoded, Opened, Picture, Source};
use crate::error::{Result, VideoError};
use crate::pixels::picture_from_image;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Frames per second of a folder, which has no clock.
pub const FOLDER_FPS: f64 = 24.0;
const EXTENSIONS: [&str; 4] = ["png", "jpg", "jpeg", "webp"];
const BATCH: usize = 16;

/// The folder source.
pub struct Folder;

impl Source for Folder {
    fn name(&self) -> &'static str {
        "folder of frames"
    }

    fn accepts(&self, path: &Path, _head: &[u8]) -> bool {
        path.is_dir()
    }

    fn open(&self, path: &Path) -> Result<Box<dyn Opened>> {
        let mut files = Vec::new();
        for entry in std::fs::read_dir(path).map_err(VideoError::io(path))? {
            let file = entry.map_err(VideoError::io(path))?.path();
            let extension = file.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
            if EXTENSIONS.contains(&extension.as_str()) && file.is_file() {
                files.push(file);
            }
        }
        sort_naturally(&mut files);
        let first =
            files.first().ok_or_else(|| VideoError::invalid(path, "the folder holds no PNG, JPEG or WebP frames"))?;
        let (w, h) = image::image_dimensions(first)
            .map_err(|e| VideoError::invalid(first, format!("not a readable picture: {e}")))?;
        let times_secs = (0..files.len()).map(|i| i as f64 / FOLDER_FPS).collect();
        Ok(Box::new(Frames { files, times_secs, size: (w as usize, h as usize) }))
    }
}

struct Frames {
    files: Vec<PathBuf>,
    times_secs: Vec<f64>,
    size: (usize, usize),
}

impl Opened for Frames {
    fn times_secs(&self) -> &[f64] {
        &self.times_secs
    }

    fn size(&self) -> (usize, usize) {
        self.size
    }

    fn decode(
        &self,
        wanted: &dyn Fn(usize) -> bool,
        finish: &(dyn Fn(Picture) -> Picture + Sync),
        sink: &mut dyn FnMut(usize, Picture),
    ) -> Result<Decoded> {
        let indices: Vec<usize> = (0..self.files.len()).filter(|&i| wanted(i)).collect();
        let mut report = Decoded { promised: indices.len(), ..Decoded::default() };
        for batch in indices.chunks(BATCH) {
            let pictures: Vec<_> = batch.par_iter().map(|&i| read_frame(&self.files[i], self.size)).collect();
            let sound = pictures.into_iter().zip(batch).filter_map(|(picture, &i)| match picture {
                Ok(picture) => Some((i, picture)),
                Err(e) => {
                    report.warnings.push(e.to_string());
                    None
                }
            });
            let sound: Vec<(usize, Picture)> = sound.collect();
            report.sound += sound.len();
            for (i, picture) in sound.into_par_iter().map(|(i, p)| (i, finish(p))).collect::<Vec<_>>() {
                sink(i, picture);
            }
        }
        Ok(report)
    }
}

fn read_frame(file: &Path, size: (usize, usize)) -> Result<Picture> {
    let image = crate::pixels::open_image(file)?;
    let found = (image.width() as usize, image.height() as usize);
    if found != size {
        let reason = format!("{}×{} pixels where the first frame has {}×{}", found.0, found.1, size.0, size.1);
        return Err(VideoError::invalid(file, reason));
    }
    Ok(picture_from_image(image))
}

/// Sorts by file name, numbers by value.
pub fn sort_naturally(files: &mut [PathBuf]) {
    files.sort_by_cached_key(|f| natural_key(&f.file_name().unwrap_or_default().to_string_lossy()));
}

/// Splits a name into text and numbers, so that numbers compare by value.
fn natural_key(name: &str) -> Vec<(String, u64)> {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text_end = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(text_end);
        let digits_end = tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len());
        let (digits, tail) = tail.split_at(digits_end);
        key.push((text.to_string(), digits.parse().unwrap_or(0)));
        rest = tail;
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_2_comes_before_frame_10() {
        let mut names = ["f10.png", "f2.png", "f1.png"];
        names.sort_by_cached_key(|n| natural_key(n));
        assert_eq!(names, ["f1.png", "f2.png", "f10.png"]);
    }
}

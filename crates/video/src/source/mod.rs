//! Where frames come from: one file per kind of source.
//!
//! A new source is one file and one word in [`SOURCES`].

use crate::error::Result;
use animimic_scene::{Image, Mask};
use std::path::Path;

pub mod animation;
pub mod ffmpeg;
pub mod folder;
pub mod mp4;

/// A decoded picture with the alpha that came with it.
pub struct Picture {
    /// Colour.
    pub image: Image,
    /// Coverage, where the source has alpha.
    pub alpha: Option<Mask>,
}

/// One kind of source.
pub trait Source: Sync {
    /// Name for messages.
    fn name(&self) -> &'static str;
    /// Whether the path is of this kind. `head`: the first bytes of the file (empty for folders).
    fn accepts(&self, path: &Path, head: &[u8]) -> bool;
    /// Reads what is needed to know the frames' times.
    fn open(&self, path: &Path) -> Result<Box<dyn Opened>>;
}

/// A source whose frames are counted and timed but not yet decoded.
pub trait Opened {
    /// When each frame is shown [s], in display order, strictly increasing, first at 0.
    fn times_secs(&self) -> &[f64];
    /// Width and height of the decoded pictures [px].
    fn size(&self) -> (usize, usize);
    /// Decodes the frames for which `wanted` (by display index) holds, passes each through `finish` and hands it to `sink`,
    /// in no particular order.
    fn decode(
        &self,
        wanted: &dyn Fn(usize) -> bool,
        finish: &(dyn Fn(Picture) -> Picture + Sync),
        sink: &mut dyn FnMut(usize, Picture),
    ) -> Result<Decoded>;
}

/// How a decoding went.
#[derive(Clone, Debug, Default)]
pub struct Decoded {
    /// Frames that came out sound.
    pub sound: usize,
    /// Frames that the container promised (as far as was decoded).
    pub promised: usize,
    /// What was ignored or mended.
    pub warnings: Vec<String>,
}

/// All kinds of sources, asked in this order.
pub const SOURCES: &[&dyn Source] = &[&mp4::Mp4, &folder::Folder, &animation::Gif, &animation::Webp];

/// The member of [`SOURCES`] that takes a path.
pub fn find(path: &Path, head: &[u8]) -> Option<&'static dyn Source> {
    SOURCES.iter().copied().find(|s| s.accepts(path, head))
}

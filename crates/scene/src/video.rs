//! A video as frames at a constant rate.

use crate::Image;

/// Frames at a constant rate, resampled by timestamps when read.
#[derive(Clone, Debug, Default)]
pub struct Video {
    /// Frames per second.
    pub fps: f64,
    /// Frames, all of one size.
    pub frames: Vec<Image>,
    /// Alpha per frame, where the source has it (frame folders, GIF); it is then the mask. Empty otherwise.
    pub alpha: Vec<crate::Mask>,
    /// Frame size in the file before any resizing [px].
    pub native_size: (usize, usize),
    /// Which frame of the source (in display order) each frame is \[frame\]; empty for videos made by code.
    pub source_frames: Vec<usize>,
    /// When the source shows each frame [s], first displayed frame at 0 \[frame\]; empty for videos made by code.
    pub source_times_secs: Vec<f64>,
    /// What the reader had to mend, drop or ignore, one sentence each.
    pub warnings: Vec<String>,
}

//! Builds without the feature `neural`: says what to do.

use super::{Network, Plane};
use crate::error::{Result, VideoError};
use animimic_scene::Image;

/// Refuses.
pub fn run(network: &Network, _frames: &[Image]) -> Result<Vec<Plane>> {
    let what = "this build of the program runs no networks; build it with \
                `cargo build --release -p animimic-cli --features neural`, or give cues as files";
    Err(VideoError::Caller(format!("{}: {what}", network.file.display())))
}

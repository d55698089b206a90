//! What is read from a video: masks and point tracks, one file per provider.

mod background;
mod masks;
mod regions;
mod tracks;

pub use background::Background;
pub use masks::{MaskCue, MaskOptions, masks};
pub use tracks::{TrackOptions, tracks};

//! What is read from a video: masks and point tracks, one file per provider.

mod background;
mod files;
mod masks;
mod overlay;
mod regions;
mod tracks;

pub use background::Background;
pub use files::{packed_bits, read_depth, read_masks, read_tracks, write_depth, write_masks, write_tracks};
pub use masks::{MaskCue, MaskOptions, masks};
pub use overlay::overlay;
pub use tracks::{TrackOptions, tracks};

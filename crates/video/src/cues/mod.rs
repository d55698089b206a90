//! What is read from a video: masks, point tracks, depth; [`providers`] is the family of ways.

mod background;
mod colors;
mod files;
mod masks;
mod max_flow;
pub mod network;
mod overlay;
mod plate;
mod prior;
pub mod providers;
mod regions;
mod tracks;

pub use background::Background;
pub use files::{packed_bits, read_depth, read_masks, read_tracks, write_depth, write_masks, write_tracks};
pub use masks::{MaskCue, MaskOptions, masks};
pub use overlay::overlay;
pub use prior::masks_with_prior;
pub use tracks::{TrackOptions, tracks};

//! Videos: decode and encode, optical flow, the cues read from them (masks, tracks), and services that make them of stills.
//!
//! Mesh deformation is deliberately absent: others see only [`animimic_scene::Video`] and [`animimic_scene::Cues`].
#![deny(missing_docs)]

pub mod color;
pub mod cues;
mod cut;
pub mod error;
pub mod flow;
pub mod generate;
pub mod h264;
pub mod pixels;
mod quiet;
pub mod read;
pub mod source;
pub mod timing;
mod turn;
pub mod write;

pub use crate::error::{Result, VideoError};
pub use crate::read::{ReadOptions, read};
pub use crate::write::{encode_gif, encode_mp4, encode_png, write_gif, write_mp4, write_png, write_whole};

//! The facade: a still model and a video in, an animated model out.
//!
//! [`animate()`] is the whole way; [`evaluate()`] measures a result; [`example`] makes the shipped example.
//! This crate alone knows files, time and progress; it never prints and never parses arguments.
#![deny(missing_docs)]

pub mod camera;
pub mod error;
pub mod evaluate;
pub mod event;
pub mod example;
pub mod metrics;
pub mod pictures;
pub mod truth;

pub use animimic_scene as scene;
pub use error::Error;
pub use evaluate::{Against, Evaluation, evaluate};
pub use event::{Event, Progress};

//! The facade: a still model and a video in, an animated model out.
//!
//! [`animate()`] is the whole way; [`evaluate()`] measures a result; [`example`] makes the shipped example.
//! This crate alone knows files, time and progress; it never prints and never parses arguments.
#![deny(missing_docs)]

pub mod animate;
pub mod batch;
pub mod camera;
mod crossings;
pub mod cues;
pub mod doctor;
pub mod error;
pub mod evaluate;
pub mod event;
pub mod example;
mod film;
pub mod generate;
pub mod measure;
pub mod metrics;
pub mod physics;
pub mod pictures;
pub mod rigging;
pub mod run;
pub mod soften;
pub mod still;
pub mod tet;
pub mod truth;
pub mod turntable;

pub use animate::{Job, Report, animate, fit};
pub use animimic_fit::Preset;
pub use animimic_rig::riggers::RIGGERS;
pub use animimic_scene as scene;
pub use animimic_sim as sim;
pub use animimic_video::cues::providers::PROVIDERS as CUE_PROVIDERS;
pub use animimic_video::cues::providers::Provider as CueProvider;
pub use error::Error;
pub use evaluate::{Against, Evaluation, evaluate};
pub use event::{Event, Progress};
pub use measure::{Measure, evaluate_files};
pub use physics::Physics;

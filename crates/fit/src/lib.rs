//! Stage 1: joint motion from cues.
//!
//! File paths, printing and where cues come from are deliberately absent.
#![deny(missing_docs)]

pub mod camera;
mod color;
pub mod combined;
mod error;
#[cfg(test)]
mod fixtures;
pub mod normal;
mod presets;
pub mod quasi_newton;
pub mod reference;
pub mod rendered;
pub mod robust;
mod schedule;
pub mod smoothness;
pub mod soft;
pub mod solver;
pub mod stage1;
pub mod terms;
pub mod view;

pub use error::FitError;
pub use presets::Preset;

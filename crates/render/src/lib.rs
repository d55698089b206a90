//! Pictures of meshes on the CPU: project, rasterise, interpolate, shade, antialias, each with its adjoint.
//!
//! Losses, skeletons and graphics cards are deliberately absent. Frames run in parallel outside; one frame can be drawn
//! with one thread or with rows shared among threads, with the same bytes.
#![deny(missing_docs)]

mod between;
pub mod clip;
pub mod edges;
pub mod error;
#[cfg(test)]
mod fixtures;
pub mod font;
pub mod interpolate;
pub mod light;
pub mod normals;
pub mod overlay;
pub mod part;
pub mod picture;
mod plain;
pub mod project;
pub mod pyramid;
pub mod raster;
pub mod render;
mod setup;
pub mod shade;
pub mod silhouette;
pub mod solve_light;
pub mod srgb;
pub mod surface;
pub mod texture;

pub use crate::error::RenderError;
pub use crate::light::Light;
pub use crate::part::{Part, Parts};
pub use crate::picture::{Background, render_image};
pub use crate::project::{DCamera, ScreenPoint, project, project_vjp};
pub use crate::pyramid::{PyramidLevel, pyramid, pyramid_vjp};
pub use crate::raster::{NONE, Raster, rasterize, rasterize_parallel};
pub use crate::render::{Cotangents, Gradients, Rendered, render, render_into, render_vjp};
pub use crate::shade::{rasterize_surface, shade};
pub use crate::solve_light::{solve_exposure, solve_light};
pub use crate::surface::Surface;

//! The family of rendered losses: each compares a picture of the posed model with a frame of the video.
//!
//! A loss is one file and one word in [`NAMES`]. The chain is render → loss → cotangent of the picture → adjoint of the renderer
//! → vertices → joints; the pose's gradient is formed once, up the tree ([`animimic_rig::pose_vjp`]).
//!
//! Losses live on the upper levels of an image pyramid (means of 2 × 2, 4 × 4, 8 × 8 pixels), never on single pixels. There a
//! picture without antialiasing changes by whole colours, and the renderer's edge gradients, which are exact for losses linear in
//! the picture, would be off by up to a factor of two for L1 (the slope at one end of the jump stands for its whole). Coarse
//! levels also pull from outside the silhouette.

mod mask;
mod observed;
mod residual;
mod rgb;

pub use mask::MaskLoss;
pub use observed::Observed;
pub use residual::{Levels, Window};
pub use rgb::RgbLoss;

use animimic_render::{Cotangents, Light, Rendered, Surface, render_into, render_vjp};
use animimic_rig::{Anchor, FramePose, Kinematics, pose_vjp};
use animimic_scene::Camera;
use glam::DVec3;

/// Names of all rendered losses, in the order in which they are listed.
pub const NAMES: &[&str] = &["rgb", "mask"];

/// The cotangent of a picture: ∂L/∂colour and ∂L/∂coverage \[pixel\].
#[derive(Clone, Debug, Default)]
pub struct Adjoint {
    /// ∂L/∂(sRGB-encoded colour).
    pub rgb: Vec<[f32; 3]>,
    /// ∂L/∂coverage.
    pub mask: Vec<f32>,
}

/// A loss of a picture.
pub trait PictureLoss: Sync {
    /// Name as in [`NAMES`].
    fn name(&self) -> &'static str;
    /// The loss, and `scale` times its cotangent added to `adjoint` where there is one.
    fn value(&self, drawn: &Rendered, seen: &Observed, window: Window, adjoint: Option<(&mut Adjoint, f64)>) -> f64;
}

/// A loss with its weight.
pub struct Weighted<'a> {
    /// The loss.
    pub loss: &'a dyn PictureLoss,
    /// Its weight.
    pub weight: f64,
}

/// What is drawn, and how.
#[derive(Clone, Copy)]
pub struct Model<'a> {
    /// The tree.
    pub kinematics: &'a Kinematics,
    /// One anchor per vertex.
    pub vertices: &'a [Anchor],
    /// The surface.
    pub surface: &'a Surface,
    /// The camera.
    pub camera: &'a Camera,
}

/// Losses of one frame (unweighted, in the order given) and the gradient of their weighted sum.
#[derive(Clone, Debug, Default)]
pub struct Value {
    /// One number per loss.
    pub losses: Vec<f64>,
    /// ∂(Σ weight · loss)/∂(increments of the pose); empty if not asked for.
    pub gradient: Vec<f64>,
}

impl Value {
    /// Σ weight · loss.
    pub fn total(&self, losses: &[Weighted]) -> f64 {
        losses.iter().zip(&self.losses).map(|(l, v)| l.weight * v).sum()
    }
}

impl Model<'_> {
    /// Draws a pose and compares it with a frame.
    ///
    /// # Panics
    /// When the frame does not have the camera's size.
    pub fn evaluate(
        &self,
        losses: &[Weighted],
        seen: &Observed,
        light: &Light,
        pose: &FramePose,
        gradient: bool,
    ) -> Value {
        let posed = self.kinematics.pose(pose);
        let positions: Vec<DVec3> = self.vertices.iter().map(|a| a.position(&posed)).collect();
        let view = View { surface: self.surface, camera: self.camera };
        let (values, forces) = view.evaluate(losses, seen, light, &positions, gradient);
        let gradient = if gradient { pose_vjp(self.kinematics, &posed, self.vertices, &forces) } else { Vec::new() };
        Value { losses: values, gradient }
    }
}

/// A surface and who looks at it.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// The surface.
    pub surface: &'a Surface,
    /// The camera.
    pub camera: &'a Camera,
}

impl View<'_> {
    /// Draws the surface at some positions and compares it with a frame: the losses, unweighted, and
    /// ∂(Σ weight · loss)/∂(positions), empty if not asked for.
    ///
    /// # Panics
    /// When the frame does not have the camera's size.
    pub fn evaluate(
        &self,
        losses: &[Weighted],
        seen: &Observed,
        light: &Light,
        positions: &[DVec3],
        gradient: bool,
    ) -> (Vec<f64>, Vec<DVec3>) {
        let mut drawn = Rendered::default();
        render_into(self.camera, self.surface, positions, light, [0.0; 3], &mut drawn);
        let window = Window::around(&drawn.raster, seen);
        seen.fill_background(&mut drawn, window);
        if !gradient {
            return (losses.iter().map(|l| l.loss.value(&drawn, seen, window, None)).collect(), Vec::new());
        }
        let pixels = drawn.rgb.len();
        let mut adjoint = Adjoint { rgb: vec![[0.0; 3]; pixels], mask: vec![0.0; pixels] };
        let values =
            losses.iter().map(|l| l.loss.value(&drawn, seen, window, Some((&mut adjoint, l.weight)))).collect();
        let d = Cotangents { rgb: &adjoint.rgb, mask: &adjoint.mask, depth: &[] };
        (values, render_vjp(self.camera, self.surface, positions, light, &drawn, &d, false).positions)
    }
}

#[cfg(test)]
mod tests;

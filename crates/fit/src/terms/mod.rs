//! The family of terms: each compares a posed frame with what is known, as weighted squares of residuals.
//!
//! A term is one file and one word in [`NAMES`]. The test below loops over all of them through the assembled chain
//! (parameters → forward kinematics → skinning → projection → residual).

mod depth;
mod joint_prior;
mod pixel;

pub use depth::{Depth, DepthTarget};
pub use joint_prior::{JointPrior, JointPriors};
pub use pixel::{PixelTarget, Pixels};

use crate::normal::NormalEquations;
use animimic_rig::{Anchor, AnchorColumns, FramePose, Kinematics, Posed};
use animimic_scene::Camera;

/// Names of all terms, in the order in which they are listed.
pub const NAMES: &[&str] = &["pixels", "depth", "joint_prior"];

/// What terms of one problem share.
pub struct Context<'a> {
    /// The tree.
    pub kinematics: &'a Kinematics,
    /// The camera of the video.
    pub camera: &'a Camera,
    /// Surface points that residuals refer to.
    pub anchors: &'a [Anchor],
    /// Their Jacobian structure.
    pub columns: &'a [AnchorColumns],
}

/// A frame at which terms are evaluated.
pub struct At<'a> {
    /// Frame number.
    pub frame: usize,
    /// The parameters.
    pub pose: &'a FramePose,
    /// Forward kinematics of `pose`.
    pub posed: &'a Posed,
}

/// A sum of robust squares over one frame.
pub trait Term: Sync {
    /// Name as in [`NAMES`].
    fn name(&self) -> &'static str;
    /// Energy at a frame.
    fn energy(&self, context: &Context, at: &At) -> f64;
    /// Adds the Gauss–Newton model of the energy to `normal`; its gradient is exact (half of dE).
    fn linearize(&self, context: &Context, at: &At, normal: &mut NormalEquations);
}

//! Kinematics, skinning and their derivatives; riggers.
//!
//! Cameras and losses are deliberately absent.
#![deny(missing_docs)]

pub mod anchor;
pub mod fixtures;
pub mod helpers;
pub mod kinematics;
pub mod limbs;
pub mod morphs;
pub mod proxy;
pub mod pullback;
pub mod residual;
pub mod riggers;
pub mod smoothness;
pub mod solve_tree;

pub use anchor::{Anchor, AnchorColumns, Share};
pub use helpers::Helped;
pub use kinematics::{FramePose, Kinematics, Posed};
pub use proxy::proxy;
pub use pullback::pose_vjp;
pub use residual::Residual;

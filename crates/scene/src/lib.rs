//! Every noun of the project as a plain struct, and one file per file format under [`io`].
//!
//! Algorithms are deliberately absent but for [`solid`], what a mesh encloses: this crate says what a mesh, a rig, a motion and
//! a video *are*.
//!
//! Conventions: right-handed, Y up, seconds, radians; `a_from_b` transforms; pixel centres at +0.5;
//! f64 for geometry, 8-bit sRGB for stored pixels.
#![deny(missing_docs)]

pub mod asset;
pub mod camera;
pub mod cues;
pub mod image;
pub mod io;
pub mod mesh;
pub mod motion;
pub mod rig;
pub mod solid;
pub mod tet_mesh;
pub mod video;

pub use crate::asset::{Asset, Source};
pub use crate::camera::{Camera, CameraFile};
pub use crate::cues::{Cues, DepthKind, DepthMap, Tracks};
pub use crate::image::{Image, Mask};
pub use crate::mesh::{AlphaMode, Look, Mesh, Part, Texture};
pub use crate::motion::{Motion, Pose, Refined, Trajectory};
pub use crate::rig::{Influence, Joint, Rig, Skeleton, Skin, Slot, Transform};
pub use crate::tet_mesh::{Embedding, TetMesh};
pub use crate::video::Video;

//! What moves: poses over time, and vertices over time.

use crate::rig::Transform;
use glam::DVec3;

/// Local transforms of all joints at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Local transform \[joint\].
    pub locals: Vec<Transform>,
}

/// A clip: poses at a constant rate, the first at time 0.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Clip name.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// Poses \[frame\].
    pub poses: Vec<Pose>,
}

/// Vertex positions over time: the result of any driver.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// Frames per second.
    pub fps: f64,
    /// Positions [model unit], \[frame\]\[vertex\], world space.
    pub frames: Vec<Vec<DVec3>>,
}

/// A clip whose vertices go beyond what its poses do: the pose carries the skeleton, the trajectory is where the surface really is.
#[derive(Clone, Debug)]
pub struct Refined {
    /// The skeleton's motion.
    pub motion: Motion,
    /// The surface in the frames of the motion, in the vertex order of the asset's mesh; `None` where it is where the skin has it.
    pub trajectory: Option<Trajectory>,
}

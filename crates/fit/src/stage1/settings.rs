//! The constants of stage 1, in units that do not depend on the model's size or the number of points.

use super::solve::Strength;

/// Weights and schedules.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Weight of a mean appearance residual [1/px²].
    pub flow: f64,
    /// Weight of a mean contour residual [1/px²].
    pub contour: f64,
    /// Weight of a mean residual of given tracks [1/px²].
    pub tracks: f64,
    /// Weight of a mean residual of given depth [1/σ²].
    pub depth: f64,
    /// First temporal differences [1/diagonal²].
    pub velocity: f64,
    /// Second temporal differences [1/diagonal²].
    pub acceleration: f64,
    /// How much stronger motion along the view axis is damped than motion across it.
    pub view_axis: f64,
    /// Pull of every joint towards its rest rotation [1/rad²].
    pub rest: f64,
    /// Stiffness of a bent limb's joints against turning about other axes than its hinge [1/rad²].
    pub off_hinge: f64,
    /// The same for the limb's first joint.
    pub off_hinge_top: f64,
    /// Angle from rest beyond which a joint is pulled back [rad]: nothing folds through itself.
    pub limit_rad: f64,
    /// Stiffness of that limit [1/rad²].
    pub limit: f64,
    /// Stiffness with which parts keep from passing through each other [1/diagonal²].
    pub penetration: f64,
    /// Pull of the root against sideways displacement [1/diagonal²].
    pub lateral: f64,
    /// Pull of a floating part towards its place [1/diagonal²].
    pub slide: f64,
    /// Pull of every joint towards its rest rotation in frame 0 [1/rad²].
    pub first_frame: f64,
    /// Pull of the root towards its rest place in frame 0 [1/diagonal²].
    pub first_frame_slide: f64,
    /// Huber threshold of appearance and contour residuals at the start and the end of a frame's rounds [px].
    pub huber_px: (f64, f64),
    /// Reach of contour correspondences at the start and the end of a frame's rounds [px].
    pub reach_px: (f64, f64),
    /// Rounds of drawing and solving per frame while tracking.
    pub rounds: usize,
    /// Limbs are searched where a frame looks this many times as unlike as frame 0.
    pub search_above: f64,
    /// Factor on priors at the end of refinement, where residuals are a tenth of a pixel.
    pub final_priors: f64,
    /// Factor on smoothness at the end of refinement.
    pub final_smoothness: f64,
    /// Huber threshold at the end of refinement [px].
    pub final_huber_px: f64,
    /// Factor on appearance at the end of refinement: by then it is true to a few hundredths of a pixel.
    pub final_flow: f64,
    /// Second differences of a point against their own mean square; see [`super::liveliness`].
    pub lively_acceleration: f64,
    /// First differences, at the same scale.
    pub lively_velocity: f64,
    /// Rounds of drawing and solving all frames together in which priors step back.
    pub batch_rounds: usize,
    /// Rounds after that, at the final strength and with each point's own smoothness.
    pub final_rounds: usize,
    /// Weight of a frame's rendered colour loss [1].
    pub rgb: f64,
    /// Weight of a frame's rendered silhouette loss [1].
    pub mask: f64,
    /// Steps of the last solve, with the rendered losses.
    pub polish_steps: usize,
}

/// Factor on priors at the end of refinement for a skeleton that was made: residuals are then ten times those on an artist's skeleton.
const MADE_RIG_PRIORS: f64 = 0.3;

impl Default for Settings {
    fn default() -> Self {
        Self {
            flow: 300.0,
            contour: 150.0,
            tracks: 1000.0,
            depth: 300.0,
            velocity: 2000.0,
            acceleration: 5000.0,
            view_axis: 5.0,
            rest: 30.0,
            first_frame: 1e4,
            first_frame_slide: 1e6,
            off_hinge: 1000.0,
            off_hinge_top: 400.0,
            limit_rad: 2.2,
            limit: 300.0,
            penetration: 1e5,
            lateral: 1e5,
            slide: 3e4,
            huber_px: (6.0, 1.5),
            reach_px: (14.0, 5.0),
            rounds: 4,
            search_above: 1.25,
            final_priors: 0.02,
            final_smoothness: 0.2,
            final_huber_px: 0.5,
            final_flow: 5.0,
            lively_acceleration: 4.0,
            lively_velocity: 0.01,
            batch_rounds: 4,
            final_rounds: 6,
            rgb: 20000.0,
            mask: 5000.0,
            polish_steps: 12,
        }
    }
}

impl Settings {
    /// The same at a given strength; frame 0 stays held.
    pub fn scaled(&self, strength: Strength) -> Self {
        Self {
            rest: self.rest * strength.priors,
            slide: self.slide * strength.priors,
            off_hinge: self.off_hinge * strength.guesses,
            off_hinge_top: self.off_hinge_top * strength.guesses,
            lateral: self.lateral * strength.guesses,
            ..self.clone()
        }
    }

    /// For a skeleton that was made from the shape alone: its joints lie a little off those that the body bends at, so what remains between
    /// drawing and frame is not all about the pose. Priors step back less, or the rest would be explained by motion in depth.
    pub fn for_made_rig(self) -> Self {
        Self { final_priors: MADE_RIG_PRIORS, ..self }
    }

    /// Where depth is observed, what stands in for it steps back: hinges, sideways rest and strong smoothness are guesses at
    /// what one view does not show.
    pub fn with_known_depth(self) -> Self {
        Self { off_hinge: 0.0, off_hinge_top: 0.0, lateral: 0.0, velocity: 300.0, acceleration: 1500.0, ..self }
    }
}

//! How to step, the state between steps, and what a step reports.

use crate::error::SimError;
use crate::filter::Filter;
use glam::DVec3;

/// Where Newton starts, unless tets at the step's start are flat or inverted and the rest shape, moved there rigidly, has
/// the lower objective.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Predictor {
    /// x + h v on free vertices.
    Inertial,
    /// The previous positions.
    Rest,
    /// One linear solve in which driven displacements enter as boundary values; reuses the last factor.
    #[default]
    Linear,
}

/// Time stepping options.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Length of a frame [s]; each is cut into `substeps` equal steps.
    pub frame_time: f64,
    /// Steps per frame.
    pub substeps: usize,
    /// Newton stops when the largest vertex displacement of an iteration, over the step's length, is below this [m/s].
    pub tolerance: f64,
    /// Newton iterations after which a step gives up (and says so).
    pub max_newton: usize,
    /// Treatment of indefinite Hessians.
    pub filter: Filter,
    /// Where Newton starts.
    pub predictor: Predictor,
    /// Gravity [m/s²].
    pub gravity: DVec3,
    /// Rayleigh damping proportional to mass [1/s].
    pub mass_damping: f64,
    /// Rayleigh damping proportional to stiffness, in the rotated frame of the step's start [s].
    pub stiffness_damping: f64,
    /// Whether the line search refuses to turn an upright tet inside out. Off, tets may pass through inversion where that
    /// lowers the objective; on, a step that could only end there stops short and says so.
    pub upright: bool,
    /// Bytes of Cholesky factors `simulate` may keep for the adjoint; 0 recomputes every one.
    pub factor_memory: usize,
}

impl Default for Settings {
    /// 30 frames a second, no gravity, no damping.
    fn default() -> Self {
        Self {
            frame_time: 1.0 / 30.0,
            substeps: 1,
            tolerance: 1e-3,
            max_newton: 60,
            filter: Filter::OnDemand,
            predictor: Predictor::Linear,
            gravity: DVec3::ZERO,
            mass_damping: 0.0,
            stiffness_damping: 0.0,
            upright: false,
            factor_memory: 0,
        }
    }
}

impl Settings {
    /// Length of one step h [s].
    pub fn step_time(&self) -> f64 {
        self.frame_time / self.substeps as f64
    }

    /// Checks every range.
    pub fn validate(&self) -> Result<(), SimError> {
        let positive = |name, value: f64| match value > 0.0 && value.is_finite() {
            true => Ok(()),
            false => Err(SimError::OutOfRange { name, value, range: "positive and finite" }),
        };
        let not_negative = |name, value: f64| match value >= 0.0 && value.is_finite() {
            true => Ok(()),
            false => Err(SimError::OutOfRange { name, value, range: "zero or positive, and finite" }),
        };
        positive("frame time", self.frame_time)?;
        positive("substeps", self.substeps as f64)?;
        positive("tolerance", self.tolerance)?;
        positive("largest number of Newton iterations", self.max_newton as f64)?;
        not_negative("mass damping", self.mass_damping)?;
        not_negative("stiffness damping", self.stiffness_damping)?;
        crate::error::check_finite("gravity", &[self.gravity])
    }
}

/// Positions and velocities of every vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Positions [m], per vertex.
    pub positions: Vec<DVec3>,
    /// Velocities [m/s], per vertex.
    pub velocities: Vec<DVec3>,
}

impl State {
    /// At rest in the given positions.
    pub fn at_rest(positions: &[DVec3]) -> Self {
        Self { positions: positions.to_vec(), velocities: vec![DVec3::ZERO; positions.len()] }
    }
}

/// What happened in one step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Whether the tolerance was reached.
    pub converged: bool,
    /// Newton iterations.
    pub newton: usize,
    /// Matrices factored.
    pub factorizations: usize,
    /// Conjugate-gradient iterations on reused factors.
    pub conjugate_gradients: usize,
    /// Last Newton step's largest vertex displacement over h [m/s].
    pub residual: f64,
    /// Times a step was halved by the line search.
    pub line_search_cuts: usize,
    /// Factorisations that met an indefinite matrix.
    pub indefinite: usize,
    /// Pushes along negative curvature out of saddle points.
    pub saddle_escapes: usize,
    /// Whether the state reached is still a saddle (its adjoint is that of a stationary point, not of a minimum). Looked for
    /// with the filters that use the true Hessian, `None` and `OnDemand`.
    pub saddle: bool,
    /// Tets with det F ≤ 0 at the end.
    pub inverted: usize,
}

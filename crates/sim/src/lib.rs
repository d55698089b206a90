//! Differentiable elastodynamics: implicit steps of tetrahedral bodies, and their exact gradients.
//!
//! One screen of use:
//! ```
//! use animimic_sim::{Body, Elasticity, Model, Settings, State, fixtures, simulate, simulate_vjp};
//! let mesh = fixtures::beam([4, 1, 1], [1.0, 0.25, 0.25]);
//! let driven: Vec<u32> = (0..4).collect(); // the face x = 0
//! let body = Body::new(&mesh, &driven)?;
//! let elasticity = Elasticity::uniform(Model::FixedCorotated, mesh.tets.len(), 1e5, 0.4, 1000.0);
//! let settings = Settings { gravity: glam::DVec3::new(0.0, -9.81, 0.0), ..Settings::default() };
//! let held: Vec<_> = driven.iter().map(|&v| mesh.positions[v as usize]).collect();
//! let motion = simulate(&body, &elasticity, &settings, &State::at_rest(&mesh.positions), &vec![held; 10])?;
//! // L = Σ ½|x|² on the last frame
//! let mut d_frames = vec![vec![glam::DVec3::ZERO; mesh.positions.len()]; 10];
//! d_frames[9] = motion.steps[9].clone();
//! let gradient = simulate_vjp(&body, &elasticity, &settings, &motion, &d_frames)?;
//! assert!(gradient.d_ln_youngs[0].is_finite());
//! # Ok::<(), animimic_sim::SimError>(())
//! ```
//! Contacts, cameras and skeletons are deliberately absent: whoever drives a body says where its driven vertices go.
#![deny(missing_docs)]

pub mod fixtures;
pub mod tet;

mod adjoint;
mod assembly;
mod body;
mod damping;
mod elasticity;
mod element;
mod error;
mod filter;
mod models;
mod predictor;
mod sensitivity;
mod settings;
mod step;
mod stepper;
mod tethers;
mod trajectory;
mod winding;

pub use adjoint::{Gradient, StepGradient, step_vjp};
pub use body::Body;
pub use elasticity::Elasticity;
pub use error::SimError;
pub use filter::Filter;
pub use models::Model;
pub use sensitivity::{GaussNewtonStep, Sensitivities, gauss_newton, sensitivities};
pub use settings::{Predictor, Settings, State, StepReport};
pub use step::step;
pub use stepper::Stepper;
pub use tethers::Tether;
pub use trajectory::{Simulation, simulate, simulate_vjp};

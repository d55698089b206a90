//! Sparse symmetric systems of 3×3 blocks over points in space: one fixed pattern, many numeric factorisations.
//!
//! [`dissection`] orders the points, [`block_matrix`] holds the values in that order, [`symbolic`] finds the supernodes
//! once per pattern, [`cholesky`] factors and solves (multifrontal, deterministic for any number of threads), [`krylov`]
//! solves with a neighbouring matrix's factor as preconditioner.

pub mod block_matrix;
pub mod cholesky;
pub mod dissection;
pub mod krylov;
pub mod symbolic;

mod front;
mod parts;
mod triangular;

pub use block_matrix::{BlockMatrix, BlockPattern};
pub use cholesky::{Factor, NotPositiveDefinite};
pub use dissection::{Dissection, nested_dissection};
pub use parts::Part;
pub use symbolic::Symbolic;

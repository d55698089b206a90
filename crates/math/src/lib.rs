//! Numbers: small matrices and decompositions, rotations, sparse solves, optimisers, the gradient check.
//!
//! Meshes and files are deliberately absent.
#![deny(missing_docs)]

pub mod block_tridiagonal;
pub mod gradcheck;
pub mod lanes;
pub mod polar3;
pub mod small_spd;
pub mod so3;
pub mod sparse;
pub mod svd3;

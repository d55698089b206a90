//! Numbers: small matrices and decompositions, rotations, sparse solves, optimisers, the gradient check.
//!
//! Meshes and files are deliberately absent.
#![deny(missing_docs)]

pub mod gradcheck;

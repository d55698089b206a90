//! Soft tissue for an animation that is there already.

pub mod yielding;

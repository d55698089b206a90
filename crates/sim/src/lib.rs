//! animimic-sim

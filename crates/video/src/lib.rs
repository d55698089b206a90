//! animimic-video

//! animimic-fit

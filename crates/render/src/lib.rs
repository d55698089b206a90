//! animimic-render

//! animimic-animimic

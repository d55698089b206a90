//! `animimic`: the command line.
fn main() {}

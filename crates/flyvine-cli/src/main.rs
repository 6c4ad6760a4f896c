//! The `flyvine` command line.
fn main() {}

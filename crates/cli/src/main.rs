//! The polepair command line.
fn main() {}

//! The sutura daemon and command line.
fn main() {}

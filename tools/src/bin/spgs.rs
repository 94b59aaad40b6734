//! The `spgs` command.
fn main() {}

//! `spgs-dev`: the project's own tasks.
fn main() {}

//! The executable model of subgroups on the engine's kernels: a whole frame, planted faults, kernels that store to images, and
//! that no kernel is forgotten.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod coverage;
mod faults;
mod frame;

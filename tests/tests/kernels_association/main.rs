//! Farthest-point sampling, association, property losses and superpoint sums on the device: every kernel against its twin,
//! the whole step against the f64 reference, and the sparse association against a dense one.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub, reason = "tests")]

mod case;
mod chain;
mod kernels;
mod start;
mod step;

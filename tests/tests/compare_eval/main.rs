//! `spgs compare` and `spgs eval` from outside.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;
mod compare;
mod eval;

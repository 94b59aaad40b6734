//! `spgs view` as people use it: a window on an X server of its own, driven by a synthetic mouse and keyboard.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::alloc::System;

use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};

mod desktop;
mod details;
mod drop;
mod editing;
mod input;
mod tools;
mod window;

/// Counts what the program allocates; that of drivers and layers is theirs.
#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

//! `spgs view` as people use it: a window on an X server of its own, driven by a synthetic mouse and keyboard.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod desktop;
mod kernel;
mod window;

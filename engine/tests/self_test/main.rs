//! The self-test of a device: it passes here, and names what was planted.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "tests")]

mod planted;
mod verdicts;

use engine::gpu::{Gpu, GpuOptions, SelfTest};

/// Options that neither read nor keep anything.
fn options() -> GpuOptions {
    GpuOptions { pipeline_cache: false, self_test: SelfTest::Once, ..GpuOptions::default() }
}

fn open(options: &GpuOptions) -> Gpu {
    Gpu::open(options).unwrap_or_else(|e| panic!("tests need a Vulkan device (run ci/setup --tests): {e}"))
}

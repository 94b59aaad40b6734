//! Test harness: one device per test, and a failed test when the validation layer said anything.

pub mod compare;
mod coverage;
pub mod gradient;
pub mod kernel_case;
pub mod model;
pub mod planted;
pub mod posed;
pub mod procedural_lpips;
pub mod render_case;
pub mod widths;

use std::time::Instant;

use engine::gpu::kernel::Kernel;
use engine::gpu::{Gpu, GpuOptions};
pub use kernel_case::{KernelCase, KernelResult};

/// A device for tests, without a self-test. A missing device is a failure, never a skip.
///
/// # Panics
/// When no usable Vulkan device is found.
pub fn gpu() -> TestGpu {
    let replace_spirv = planted::planted().to_vec();
    match Gpu::open(&GpuOptions { pipeline_cache: false, replace_spirv, ..GpuOptions::default() }) {
        Ok(gpu) => {
            assert_driver(&gpu);
            TestGpu(gpu, Instant::now())
        }
        Err(error) => panic!("tests need a Vulkan device (run ci/setup --tests): {error}"),
    }
}

/// A device whose validation messages must be empty when it is dropped, and when it was opened.
#[derive(Debug)]
pub struct TestGpu(pub Gpu, Instant);

impl TestGpu {
    /// Lanes of a subgroup: the device's, or those of the executable model when that runs the kernels.
    pub fn subgroup_size(&self) -> u32 {
        model::options().map_or_else(|| self.0.subgroup_size(), |options| options.lanes)
    }

    /// The same for the pipelines of one kernel.
    pub fn subgroup_size_of(&self, kernel: &Kernel) -> u32 {
        model::options().map_or_else(|| self.0.subgroup_size_of(kernel), |options| options.lanes)
    }
}

impl std::ops::Deref for TestGpu {
    type Target = Gpu;
    fn deref(&self) -> &Gpu {
        &self.0
    }
}

impl Drop for TestGpu {
    fn drop(&mut self) {
        coverage::write(&self.0, self.subgroup_size(), self.1);
        let messages = self.0.take_validation_messages();
        if !messages.is_empty() && !std::thread::panicking() {
            panic!("the validation layer reported {} messages, first: {}", messages.len(), messages[0]);
        }
    }
}

/// Whether tests shall be as small as they can be and still run every kernel: `SPGS_TEST_SMALL=1`, for drivers beside the
/// system's own.
pub fn small() -> bool {
    std::env::var("SPGS_TEST_SMALL").is_ok_and(|v| v == "1")
}

/// The driver is the one that `SPGS_TEST_DRIVER` names, if it is set: part of its name and version.
///
/// # Panics
/// When it is another one.
pub fn assert_driver(gpu: &Gpu) {
    if let Ok(wanted) = std::env::var("SPGS_TEST_DRIVER") {
        let found = &gpu.info().driver;
        assert!(found.contains(&wanted), "the driver is `{found}`, expected `{wanted}` (SPGS_TEST_DRIVER)");
    }
}

/// The folder of real test data from `SPGS_DATA`. Without it the test is skipped loudly, unless `SPGS_REQUIRE_DATA=1`.
///
/// # Panics
/// When the data is required but absent.
pub fn data(relative: &str) -> Option<std::path::PathBuf> {
    let found =
        std::env::var_os("SPGS_DATA").map(|d| std::path::PathBuf::from(d).join(relative)).filter(|p| p.exists());
    if found.is_none() {
        assert!(
            std::env::var("SPGS_REQUIRE_DATA").as_deref() != Ok("1"),
            "SPGS_REQUIRE_DATA=1, but {relative} is not found under SPGS_DATA"
        );
        eprintln!("SKIPPED: {relative} not found; set SPGS_DATA to the folder of real data");
    }
    found
}

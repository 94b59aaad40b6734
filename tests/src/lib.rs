//! Test harness: one device at a time per test, and a failed test when the validation layer said anything.

pub mod compare;
mod coverage;
pub mod gradient;
pub mod kernel_case;
pub mod model;
pub mod planted;
pub mod posed;
pub mod procedural_lpips;
pub mod render_case;
pub mod tile_chain;
pub mod widths;

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use engine::gpu::kernel::Kernel;
use engine::gpu::{Gpu, GpuOptions};
pub use kernel_case::{KernelCase, KernelResult};

/// A device of its own for a test, without a self-test. A missing device is a failure, never a skip.
///
/// # Panics
/// When no usable Vulkan device is found.
pub fn gpu() -> TestGpu {
    TestGpu { gpu: open(), opened: Instant::now(), shared: false }
}

/// Devices that no test has at the moment, with the pipelines of the tests before.
static IDLE: Mutex<Vec<Gpu>> = Mutex::new(Vec::new());

/// A device that the tests of a program hand on to each other, one at a time: what is made once, as pipelines are, is most of
/// the time of tests of kernels. A test that looks at the device itself takes [`gpu`].
///
/// # Panics
/// When no usable Vulkan device is found.
pub fn shared_gpu() -> TestGpu {
    let idle = IDLE.lock().unwrap_or_else(PoisonError::into_inner).pop();
    TestGpu { gpu: idle.unwrap_or_else(open), opened: Instant::now(), shared: true }
}

fn open() -> Gpu {
    let replace_spirv = planted::planted().to_vec();
    match Gpu::open(&GpuOptions { pipeline_cache: false, replace_spirv, ..GpuOptions::default() }) {
        Ok(gpu) => {
            assert_driver(&gpu);
            gpu
        }
        Err(error) => panic!("tests need a Vulkan device (run ci/setup --tests): {error}"),
    }
}

/// A device whose validation messages must be empty when a test is done with it, and when it was taken. Of a shared one no
/// buffer may be left either.
#[derive(Debug)]
pub struct TestGpu {
    gpu: Gpu,
    opened: Instant,
    shared: bool,
}

impl TestGpu {
    /// Lanes of a subgroup: the device's, or those of the executable model when that runs the kernels.
    pub fn subgroup_size(&self) -> u32 {
        model::options().map_or_else(|| self.gpu.subgroup_size(), |options| options.lanes)
    }

    /// The same for the pipelines of one kernel.
    pub fn subgroup_size_of(&self, kernel: &Kernel) -> u32 {
        model::options().map_or_else(|| self.gpu.subgroup_size_of(kernel), |options| options.lanes)
    }
}

impl std::ops::Deref for TestGpu {
    type Target = Gpu;
    fn deref(&self) -> &Gpu {
        &self.gpu
    }
}

impl Drop for TestGpu {
    fn drop(&mut self) {
        coverage::write(&self.gpu, self.subgroup_size(), self.opened);
        let messages = self.gpu.take_validation_messages();
        if std::thread::panicking() {
            return;
        }
        if let Some(first) = messages.first() {
            panic!("the validation layer reported {} messages, first: {first}", messages.len());
        }
        if self.shared {
            assert_eq!(self.gpu.buffer_count(), 0, "buffers that the test left behind");
            IDLE.lock().unwrap_or_else(PoisonError::into_inner).push(self.gpu.clone());
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

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;

    /// One test: another of this program might take the device in between.
    #[test]
    fn shared_devices_keep_pipelines_and_tell_of_buffers() {
        let first = shared_gpu();
        let kernel = engine::kernels().find(|k| k.spec.len() == 1).unwrap();
        first.compile(kernel, &[]).unwrap();
        drop(first);
        let again = shared_gpu();
        assert!(again.compiled_names().contains(kernel.name));
        let left = again.buffer("left", 16, engine::gpu::Memory::Device).unwrap();
        let told = catch_unwind(AssertUnwindSafe(|| drop(again))).unwrap_err();
        assert!(told.downcast_ref::<String>().is_some_and(|why| why.contains("left behind")));
        drop(left);
    }
}

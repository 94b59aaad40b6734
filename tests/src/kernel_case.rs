//! A kernel on the device beside its CPU twin, as the engine compares them ([`engine::gpu::proof`]), with panics for tests.

use engine::gpu::Gpu;
use engine::gpu::kernel::Kernel;
use engine::gpu::proof;
pub use engine::gpu::proof::{POISON, SENTINEL_BYTES};

/// Input of one comparison.
#[derive(Debug, Clone)]
pub struct KernelCase {
    /// The kernel.
    pub kernel: &'static Kernel,
    /// Specialisation constants from id 1 on.
    pub spec: Vec<u32>,
    /// Push constants.
    pub push: Vec<u8>,
    /// Words of each binding before the run (write-only buffers are poisoned).
    pub buffers: Vec<Vec<u32>>,
    /// Workgroups.
    pub groups: u32,
}

/// What both sides left in the buffers.
#[derive(Debug)]
pub struct KernelResult {
    /// From the device.
    pub gpu: Vec<Vec<u32>>,
    /// From the twin.
    pub twin: Vec<Vec<u32>>,
}

impl KernelCase {
    /// Runs both sides.
    ///
    /// # Panics
    /// When the device fails or a sentinel was overwritten.
    pub fn run(self, gpu: &Gpu) -> KernelResult {
        let Self { kernel, spec, push, buffers, groups } = self;
        let result = proof::KernelCase { kernel, spec, push, buffers, groups }.run(gpu);
        let result = result.unwrap_or_else(|error| panic!("{error}"));
        KernelResult { gpu: result.gpu, twin: result.twin }
    }
}

impl KernelResult {
    /// Asserts that every buffer agrees: integers bit for bit, floats within the kernel's tolerance.
    ///
    /// # Panics
    /// When they do not.
    pub fn assert_equal(&self, kernel: &'static Kernel, context: &str) {
        if let Some(mismatch) = proof::mismatch(kernel, &self.gpu, &self.twin) {
            panic!("{} {context}: {}", kernel.name, mismatch.why());
        }
    }
}

//! A kernel on the device, or on the executable model in its place, beside its CPU twin, as the engine compares them
//! ([`engine::gpu::proof`]), with panics for tests.

use engine::gpu::Gpu;
use engine::gpu::kernel::Kernel;
use engine::gpu::proof;
pub use engine::gpu::proof::{POISON, SENTINEL_BYTES};

use crate::coverage;
use crate::model::{self, Options};

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
    /// From the device, or the model in its place.
    pub gpu: Vec<Vec<u32>>,
    /// From the twin.
    pub twin: Vec<Vec<u32>>,
}

impl KernelCase {
    /// Runs both sides; with `SPGS_TEST_MODEL` the executable model in place of the device ([`crate::model`]).
    ///
    /// # Panics
    /// When the device fails, a sentinel was overwritten, or the model finds an error.
    pub fn run(self, gpu: &Gpu) -> KernelResult {
        coverage::compared(self.kernel);
        if let Some(options) = model::options() {
            return self.run_model(&options);
        }
        self.into_proof().run(gpu).unwrap_or_else(|error| panic!("{error}")).into()
    }

    /// Runs the executable model and the twin.
    ///
    /// # Panics
    /// When the model finds an error.
    pub fn run_model(mut self, options: &Options) -> KernelResult {
        let mut case = self.clone().into_proof();
        case.poison();
        self.buffers.clone_from(&case.buffers);
        let result = model::run(&self, options);
        case.with_twin(options.lanes, result).into()
    }

    fn into_proof(self) -> proof::KernelCase {
        let Self { kernel, spec, push, buffers, groups } = self;
        proof::KernelCase { kernel, spec, push, buffers, groups }
    }
}

impl From<proof::KernelResult> for KernelResult {
    fn from(result: proof::KernelResult) -> Self {
        Self { gpu: result.gpu, twin: result.twin }
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

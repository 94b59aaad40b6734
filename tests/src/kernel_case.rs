//! A kernel on the device, or on the executable model in its place, beside its CPU twin, as the engine compares them
//! ([`engine::gpu::proof`]), with panics for tests.

use engine::gpu::Gpu;
use engine::gpu::interface::{Interface, KernelOf, of_words};
use engine::gpu::proof;
pub use engine::gpu::proof::{POISON, SENTINEL_BYTES};

use crate::coverage;
use crate::model::{self, Options};

/// Input of one comparison.
#[derive(Debug)]
pub struct KernelCase<I: Interface> {
    /// The kernel.
    pub kernel: &'static KernelOf<I>,
    /// Specialisation constants.
    pub constants: I::Constants,
    /// Push constants.
    pub push: I::Push,
    /// Words of each buffer before the run (write-only buffers are poisoned).
    pub buffers: I::Buffers<Vec<u32>>,
    /// Workgroups.
    pub groups: u32,
}

impl<I: Interface> Clone for KernelCase<I>
where
    I::Buffers<Vec<u32>>: Clone,
{
    fn clone(&self) -> Self {
        Self { buffers: self.buffers.clone(), ..*self }
    }
}

/// What both sides left in the buffers.
#[derive(Debug)]
pub struct KernelResult<I: Interface> {
    /// The kernel.
    pub kernel: &'static KernelOf<I>,
    /// From the device, or the model in its place.
    pub gpu: I::Buffers<Vec<u32>>,
    /// From the twin.
    pub twin: I::Buffers<Vec<u32>>,
    mismatch: Option<String>,
}

impl<I: Interface> KernelCase<I> {
    /// Runs both sides; with `SPGS_TEST_MODEL` the executable model in place of the device ([`crate::model`]).
    ///
    /// # Panics
    /// When the device fails, a sentinel was overwritten, or the model finds an error.
    pub fn run(self, gpu: &Gpu) -> KernelResult<I> {
        coverage::compared(self.kernel);
        if let Some(options) = model::options() {
            return self.run_model(&options);
        }
        let kernel = self.kernel;
        KernelResult::of(kernel, self.into_words().run(gpu).unwrap_or_else(|error| panic!("{error}")))
    }

    /// Runs the executable model and the twin.
    ///
    /// # Panics
    /// When the model finds an error.
    pub fn run_model(self, options: &Options) -> KernelResult<I> {
        let kernel = self.kernel;
        KernelResult::of(kernel, model::run_beside_twin(self.into_words(), options))
    }

    /// [`KernelCase::run`], and every buffer agrees: integers bit for bit, floats within the kernel's tolerance.
    ///
    /// # Panics
    /// When they do not, or as [`KernelCase::run`].
    pub fn check(self, gpu: &Gpu, context: &str) -> I::Buffers<Vec<u32>> {
        let result = self.run(gpu);
        result.assert_equal(context);
        result.gpu
    }

    /// The case without names.
    pub fn into_words(self) -> proof::KernelCase {
        proof::KernelCase::new(self.kernel, self.constants, self.push, self.buffers, self.groups)
    }
}

impl<I: Interface> KernelResult<I> {
    fn of(kernel: &'static KernelOf<I>, result: proof::KernelResult) -> Self {
        let mismatch = result.mismatch().map(|m| m.why());
        Self { kernel, gpu: of_words::<I>(result.gpu), twin: of_words::<I>(result.twin), mismatch }
    }

    /// Asserts that every buffer agrees: integers bit for bit, floats within the kernel's tolerance.
    ///
    /// # Panics
    /// When they do not.
    pub fn assert_equal(&self, context: &str) {
        if let Some(why) = &self.mismatch {
            panic!("{} {context}: {why}", self.kernel.name);
        }
    }
}

impl<I: Interface> From<KernelCase<I>> for proof::KernelCase {
    fn from(case: KernelCase<I>) -> Self {
        case.into_words()
    }
}

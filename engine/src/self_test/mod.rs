//! A device is trusted after it has proven itself.
//!
//! Drivers differ, and some are wrong without saying so: a barrier that is left out, a compiler's mistake, a driver that
//! computes nothing at all. So the first use of a device with its driver and these shaders begins with a self-test on small
//! inputs ([`Gpu::new`]; [`Gpu::open`] has none):
//!
//! - copies, order and size of subgroups, their operations, atomics of many workgroups, every pass of a radix sort;
//! - a frame from a table of poses, exact: each dispatch against its CPU twin (`gpu::proof`);
//! - a whole frame against the f64 reference ([`crate::reference`]);
//! - for training ([`GpuOptions::training`]): a step with density control, each dispatch against its twin, and steps whose
//!   loss must fall.
//!
//! What only some programs use is tested when it is first used, in the same way: frames in reduced quality and for windows,
//! networks F and G, deformation fields, training of the non-rigid stage ([`Suite`]). So a test compiles hardly any pipeline
//! that is not needed anyway. Kernels that store into a host's image are not tested.
//!
//! The verdict is kept beside the pipeline cache, one file per device and suite ([`known`]), and holds until driver, shaders or
//! subgroup size change. A device that fails is named with the kernel and the difference ([`Error::SelfTest`]), and the next one
//! is tried unless it was asked for. `SPGS_SELF_TEST=0` skips all of it.
//!
//! A host's device ([`Gpu::from_host`]) is tested when the host calls [`Gpu::self_test`].

mod basics;
mod fields;
mod frame;
mod networks;
mod open;
mod packed;
mod soft;
mod subgroup_order;
mod training;
mod verdict;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crate::error::{Error, Result};
pub use crate::gpu::Suite;
use crate::gpu::capability::TRAINING_STORAGE_BUFFERS;
use crate::gpu::proof::Watch;
use crate::gpu::{DeviceInfo, Gpu, GpuOptions, Kernel};
#[doc(hidden)]
pub use subgroup_order::{SUBGROUP_ORDER, SubgroupOrderBuffers, SubgroupOrderPush};
pub use verdict::{Subject, Verdict, known};

/// Kernels of this module.
#[doc(hidden)]
pub static KERNELS: &[&Kernel] = &[&SUBGROUP_ORDER.kernel];

impl Suite {
    /// Whether a device has what the suite needs. One that cannot train is not tested for it.
    pub fn fits(self, info: &DeviceInfo) -> bool {
        !self.trains() || info.capabilities.max_storage_buffers >= TRAINING_STORAGE_BUFFERS
    }
}

/// Suites that this process has run.
static RUNS: AtomicU64 = AtomicU64::new(0);

/// How many suites this process has run; what is known of a device already is not run again.
pub fn runs() -> u64 {
    RUNS.load(Ordering::Relaxed)
}

impl Gpu {
    /// Runs a suite now, whatever is known of the device, and keeps the verdict. Takes a fraction of a second once the kernels are
    /// compiled; nothing else should work on the device meanwhile.
    ///
    /// # Errors
    /// `SelfTest` naming the kernel or check that failed and the difference.
    pub fn self_test(&self, suite: Suite) -> Result<Verdict> {
        RUNS.fetch_add(1, Ordering::Relaxed);
        self.begin_proof(suite);
        let start = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| run(self, suite)));
        let outcome = outcome.unwrap_or_else(|_| {
            let why = "a result that makes no sense stopped the test".to_owned();
            Err(Error::Kernel { kernel: "unknown".into(), why })
        });
        let seconds = start.elapsed().as_secs_f64();
        let failure = outcome.as_ref().err().map(ToString::to_string);
        let subject = Subject::of(self.info(), self.options());
        let verdict = Verdict::now(subject, suite, failure, seconds);
        // Wrong results stay wrong; a time-out or a lack of memory may pass.
        if matches!(outcome, Ok(()) | Err(Error::Kernel { .. })) {
            verdict::keep(self.info(), self.options(), &verdict);
        }
        judged(verdict).inspect_err(|_| self.fail_proof(suite))
    }

    /// Runs a suite unless the device is known to have passed or failed it.
    ///
    /// # Errors
    /// As [`Gpu::self_test`].
    pub fn require_self_test(&self, suite: Suite) -> Result<Verdict> {
        match known(self.info(), self.options(), suite) {
            Some(verdict) => judged(verdict),
            None => self.self_test(suite),
        }
    }
}

fn run(gpu: &Gpu, suite: Suite) -> Result<()> {
    match suite {
        Suite::Frame => {
            basics::test(gpu)?;
            frame::test(gpu)
        }
        Suite::Packed => packed::test(gpu),
        Suite::Networks => networks::test(gpu),
        Suite::Soft => soft::test(gpu),
        Suite::Fields => fields::test(gpu),
        Suite::Training => training::test(gpu),
        Suite::SoftTraining => training::test_soft(gpu),
        Suite::Nonrigid => training::test_nonrigid(gpu),
    }
}

/// The first dispatch that went wrong, as an error.
fn check(watch: &Watch) -> Result<()> {
    watch.mismatch()?.map_or(Ok(()), |mismatch| Err(mismatch.into_error()))
}

/// What came of work on a watched device. A kernel that went wrong says more than what became of it, but nothing can be read
/// that the device still works on.
fn outcome<T>(watch: &Watch, done: Result<T>) -> Result<T> {
    if !matches!(done, Err(Error::TimedOut { .. })) {
        check(watch)?;
    }
    done
}

/// The verdict, or what is wrong with the device as an error.
fn judged(verdict: Verdict) -> Result<Verdict> {
    match &verdict.failure {
        None => Ok(verdict),
        Some(why) => Err(Error::SelfTest {
            device: verdict.subject.device.clone(),
            driver: verdict.subject.driver.clone(),
            why: why.clone(),
        }),
    }
}

/// Suites that these options ask for at once; the others are run when their kernels are first needed.
fn wanted(options: &GpuOptions, info: &DeviceInfo) -> impl Iterator<Item = Suite> {
    let training = options.training && Suite::Training.fits(info);
    [Suite::Frame].into_iter().chain(training.then_some(Suite::Training))
}

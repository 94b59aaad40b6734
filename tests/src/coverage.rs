//! Which test runs which kernels, at which subgroup size, and for how long: one JSON object per device and line, appended to the
//! file that `SPGS_TEST_COVERAGE` names. `spgs-dev mutants` chooses by it the tests that can see a fault, and the gate sees that
//! no kernel goes without a case against its twin (`tests/kernel_coverage.rs`).

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::io::Write as _;
use std::time::Instant;

use engine::gpu::Gpu;
use engine::gpu::kernel::Kernel;

thread_local! {
    /// Kernels that this thread's test compared with their twins since the last line was written.
    static COMPARED: RefCell<BTreeSet<&'static str>> = const { RefCell::new(BTreeSet::new()) };
}

/// Notes that a test compares a kernel with its twin.
pub(crate) fn compared(kernel: &Kernel) {
    COMPARED.with_borrow_mut(|names| names.insert(kernel.name));
}

/// Writes what a test did with a device that it opened at `opened`. The test harness names a thread after its test.
///
/// # Panics
/// When the file cannot be written.
pub(crate) fn write(gpu: &Gpu, lanes: u32, opened: Instant) {
    let Some(path) = std::env::var_os("SPGS_TEST_COVERAGE") else { return };
    let line = serde_json::json!({
        "test": std::thread::current().name(),
        "compared": COMPARED.take(),
        "lanes": lanes,
        "kernels": gpu.compiled_names(),
        "seconds": opened.elapsed().as_secs_f64(),
    });
    let mut file = std::fs::OpenOptions::new().append(true).create(true).open(path).unwrap();
    // In one write: other tests write at the same time.
    file.write_all(format!("{line}\n").as_bytes()).unwrap();
}

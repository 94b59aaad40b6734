//! Which kernels ran beside their twins, at which subgroup sizes: with `SPGS_TEST_KERNEL_LOG=FILE` each
//! [`KernelCase`](crate::KernelCase) leaves a line `LANES NAME` there. The gate reads it (`tests/kernel_coverage.rs`), so that
//! no kernel goes without a case.

use std::collections::BTreeSet;
use std::io::Write as _;
use std::sync::{Mutex, PoisonError};

use engine::gpu::kernel::Kernel;

static NOTED: Mutex<BTreeSet<(u32, &'static str)>> = Mutex::new(BTreeSet::new());

/// Notes that a case of this kernel runs on a device with this subgroup size.
///
/// # Panics
/// When the log cannot be written.
pub fn note(kernel: &'static Kernel, lanes: u32) {
    let Some(path) = std::env::var_os("SPGS_TEST_KERNEL_LOG") else { return };
    if NOTED.lock().unwrap_or_else(PoisonError::into_inner).insert((lanes, kernel.name)) {
        let mut file = std::fs::OpenOptions::new().append(true).create(true).open(path).unwrap();
        writeln!(file, "{lanes} {}", kernel.name).unwrap();
    }
}

//! Proof of kernels: what a device made of a dispatch, beside what the kernel's CPU twin makes of the same input.
//!
//! [`KernelCase`] runs one kernel on given buffers, with sentinels around each and poison in those that it only writes.
//! [`Watch`] looks over the shoulder of whatever is recorded with [`Gpu::watched`](super::Gpu::watched): a frame or a training
//! step as it is, each dispatch checked for itself. The tests and the self-test of a device use both.

mod case;
mod compare;
mod watch;

pub use case::{KernelCase, KernelResult, SENTINEL_BYTES};
pub use compare::Mismatch;
pub use watch::Watch;

use super::kernel::Kernel;

/// A quiet NaN with a recognisable payload: an element that stays so was never written.
pub const POISON: u32 = 0x7FC0_DEAD;

/// The first buffer of what a kernel left in its bindings that differs from what the twin left: integers bit for bit, floats
/// within the kernel's tolerance.
pub fn mismatch(kernel: &'static Kernel, found: &[Vec<u32>], expected: &[Vec<u32>]) -> Option<Mismatch> {
    compare::compare(kernel, kernel.name, found, expected)
}

/// Little-endian bytes as words.
fn words_of(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

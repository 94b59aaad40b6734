//! Network G (non-rigid stage): forward, backward, Adam.

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[];

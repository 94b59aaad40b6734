//! Dense layers: tiled matrix kernels, forward and backward.

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[];

//! Adaptive density control: clone, split, prune, opacity reset.

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[];

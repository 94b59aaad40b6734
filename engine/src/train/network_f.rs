//! Network F in training: forward with kept activations, backward, Adam.

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[];

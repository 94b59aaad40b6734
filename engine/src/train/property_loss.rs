//! Property reconstruction loss and the superpoints' gradients.

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[];

//! The sparse association matrix: nearest superpoints, softmax, assignment, superpoint centres.

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[];

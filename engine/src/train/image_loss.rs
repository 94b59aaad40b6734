//! Image loss (1−λ)·L1 + λ·(1−SSIM) and its gradient.

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[];

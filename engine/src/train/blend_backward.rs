//! Blend backward: from the image's gradient to the splats' gradients.

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[];

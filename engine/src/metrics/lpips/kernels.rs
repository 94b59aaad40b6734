//! What the kernels of LPIPS share.

use super::lpips_conv::LPIPS_CONV;
use super::lpips_difference::LPIPS_DIFFERENCE;
use super::lpips_pool::LPIPS_POOL;
use crate::gpu::kernel::{Kernel, Tolerance};
use crate::gpu::product::PRODUCT_THREADS;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&LPIPS_CONV.kernel, &LPIPS_POOL.kernel, &LPIPS_DIFFERENCE.kernel];

/// Threads per workgroup.
pub(super) const THREADS: u32 = PRODUCT_THREADS;

/// Sums of up to 4608 products of numbers around 1, fused or not, in another order than the twin's.
pub(super) const SUMS: Tolerance = Tolerance { absolute: 1e-4, relative: 2e-5, flips: 0.0 };

/// Word `i` as a float, for twins, whose sums are in f64.
pub(super) fn value(words: &[u32], i: u32) -> f64 {
    f32::from_bits(words[i as usize]).into()
}

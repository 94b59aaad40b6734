//! Kernel `density_histogram`: the keys of those that grow, one digit at a time, to select those within the budget.

use super::{ACTION_CLONE, DENSITY_BLOCK, mean_gradient};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::twin::f32_at;

/// Words of `histogram`.
pub const HISTOGRAM_WORDS: u32 = 2048;

crate::gpu_struct! {
    /// Push constants of `density_histogram`.
    pub struct DensityHistogramPush {
        /// N.
        pub gaussians: u32,
        /// 0: keys are gradient bits; 1: inverted indices of those whose gradient bits are `tie_key`.
        pub by_index: u32,
        /// See `by_index`.
        pub tie_key: u32,
        /// Bits of the key that are known.
        pub prefix_mask: u32,
        /// Their values.
        pub prefix: u32,
        /// Lowest bit of the digit.
        pub shift: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`DENSITY_HISTOGRAM`].
    pub struct DensityHistogramBuffers {
        /// `float[2][N]`: sum of screen-gradient norms, number of views.
        density: Read F32,
        /// `uint[N]`, as `density_decide` leaves it.
        action: Read U32,
        /// `uint[2048]`; zero before.
        histogram: Atomic U32,
    }
}

crate::kernel! {
    /// Dispatch ceil(N / 256) workgroups after `density_decide`.
    pub static DENSITY_HISTOGRAM: DensityHistogram = {
        name: "density_histogram",
        doc: "counts one 11-bit digit of the growing Gaussians' keys, to select those within the budget",
        local_size: DENSITY_BLOCK,
        constants: (),
        push: DensityHistogramPush,
        buffers: DensityHistogramBuffers,
        twin: density_histogram_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 12 * w.get("gaussians"),
    }
}

fn density_histogram_twin(call: Call<'_, DensityHistogram>) {
    let Call { push, buffers: b, .. } = call;
    let n = push.gaussians as usize;
    for i in (0..n).filter(|&i| b.action[i] >= ACTION_CLONE) {
        let bits = mean_gradient(f32_at(b.density, i), f32_at(b.density, n + i)).to_bits();
        let key = if push.by_index == 1 { !(i as u32) } else { bits };
        let candidate = push.by_index == 0 || bits == push.tie_key;
        if candidate && key & push.prefix_mask == push.prefix {
            b.histogram[((key >> push.shift) & (HISTOGRAM_WORDS - 1)) as usize] += 1;
        }
    }
}

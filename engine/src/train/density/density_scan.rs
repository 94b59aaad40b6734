//! Kernel `density_scan`: where the new rows of each block of Gaussians begin.

use super::DENSITY_BLOCK;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_struct! {
    /// Push constants of `density_scan`.
    pub struct DensityScanPush {
        /// Words of `row_block`.
        pub blocks: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`DENSITY_SCAN`].
    pub struct DensityScanBuffers {
        /// New rows of each block of 256 Gaussians, then of all blocks before it.
        row_block: Update U32,
    }
}

crate::kernel! {
    /// Dispatch 1 workgroup.
    pub static DENSITY_SCAN: DensityScan = {
        name: "density_scan",
        doc: "exclusive prefix sum of the blocks' row counts, in place",
        local_size: DENSITY_BLOCK,
        constants: (),
        push: DensityScanPush,
        buffers: DensityScanBuffers,
        twin: density_scan_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 8 * w.get("gaussians") / 256,
    }
}

fn density_scan_twin(call: Call<'_, DensityScan>) {
    let mut before = 0;
    for count in &mut call.buffers.row_block[..call.push.blocks as usize] {
        before += std::mem::replace(count, before);
    }
}

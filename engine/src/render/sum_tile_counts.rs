//! Kernel `sum_tile_counts`: where the tile instances of each block of depth-sorted Gaussians begin.

use super::limits::{SCAN_BLOCK, SCAN_SUPER};
use super::tiles::visible_of;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_struct! {
    /// Push constants of [`SUM_TILE_COUNTS`].
    pub struct SumTileCountsPush {
        /// Where the super sums of `instance_block` start, in words: its capacity of block sums.
        pub block_capacity: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SUM_TILE_COUNTS`].
    pub struct SumTileCountsBuffers {
        counters: Read U32,
        /// `[N]`: tiles that each Gaussian reaches.
        tile_count: Read U32,
        /// `[visible]`: Gaussians by depth.
        order: Read U32,
        /// Tile instances per block of 256, then per super block; must be zero.
        instance_block: Atomic U32,
    }
}

crate::kernel! {
    /// Block sums of tile counts. Dispatch ceil(visible / 256) workgroups; `instance_block` must be zero.
    pub static SUM_TILE_COUNTS: SumTileCounts = {
        name: "sum_tile_counts",
        doc: "sums tile counts over blocks of 256 depth-sorted Gaussians and over 256 blocks",
        local_size: 256,
        constants: (),
        push: SumTileCountsPush,
        buffers: SumTileCountsBuffers,
        twin: sum_tile_counts_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 8 * w.get("visible"),
    }
}

fn sum_tile_counts_twin(call: Call<'_, SumTileCounts>) {
    let groups = call.group_count();
    let Call { push, buffers: b, .. } = call;
    let visible = visible_of(b.counters);
    for group in 0..groups.min(visible.div_ceil(SCAN_BLOCK)) {
        let first = group * SCAN_BLOCK;
        let block = first..visible.min(first + SCAN_BLOCK);
        let total: u32 = block.map(|i| b.tile_count[b.order[i as usize] as usize]).sum();
        b.instance_block[group as usize] = total;
        b.instance_block[(push.block_capacity + group / SCAN_SUPER) as usize] += total;
    }
}

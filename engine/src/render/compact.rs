//! `compact`: the visible Gaussians, in index order, as (depth key, index) pairs for the depth sort, and the arguments
//! of the indirect dispatches that follow.

use super::frame::Frame;
use super::limits::*;
use super::splat::splat_words;
use super::tiles::sum_before;
use super::twin;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_struct! {
    /// Push constants of `compact`.
    pub struct CompactPush {
        /// Where the super sums of `visible_block` start, in words: its capacity of block sums.
        pub block_capacity: u32,
        /// Width of the first depth digit.
        pub digit_bits: u32,
        /// log2 of the keys of a partition of the depth sort.
        pub depth_partition_shift: u32,
        /// The same of the tile sort.
        pub tile_partition_shift: u32,
    }
}

/// Gaussians per workgroup of `compact`.
pub const COMPACT_GAUSSIANS: u32 = 1024;

/// Word of `indirect` where the depth sort's group counts are: one per partition of `visible`.
pub const INDIRECT_DEPTH_SORT: u32 = 0;
/// The same for `sum_tile_counts` and `emit_tiles`: ceil(visible / 256).
pub const INDIRECT_EMIT: u32 = 4;
/// The same for the tile sort: one per partition of the instances.
pub const INDIRECT_TILE_SORT: u32 = 8;
/// The same for `tile_ranges`: ceil(instances / 256).
pub const INDIRECT_RANGES: u32 = 12;
/// Words of `indirect`.
pub const INDIRECT_WORDS: u32 = 16;

crate::gpu_constants! {
    /// Specialisation constants of [`COMPACT`].
    pub struct CompactConstants {
        /// Bits of a depth key; 0 for all 32 of the float.
        depth_bits,
        /// How splats are stored ([`super::splat`]).
        packing,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`COMPACT`].
    pub struct CompactBuffers {
        frame: Read Struct(Frame),
        /// `[N]`: tiles that each Gaussian reaches; 0 is not visible.
        tile_count: Read U32,
        /// `[N]` splats ([`super::splat`]).
        splats: Read F32,
        /// Visible Gaussians per block of 256, then per super block.
        visible_block: Read U32,
        counters: Atomic U32,
        /// `[16]`: workgroups of the dispatches that follow.
        indirect: Write U32,
        /// `[visible]`: depth keys.
        keys: Write U32,
        /// `[visible]`: Gaussians.
        values: Write U32,
        /// `[partition][256]` counts of the first depth digit; must be zero.
        next_histogram: Atomic U32,
    }
}

crate::kernel! {
    /// Stable compaction. Dispatch ceil(gaussians / 1024) workgroups; `next_histogram` must be zero.
    pub static COMPACT: Compact = {
        name: "compact",
        doc: "packs the visible Gaussians into (depth key, index) pairs in index order, counts the first depth digit, \
              writes indirect arguments and the capacity failure",
        local_size: 256,
        constants: CompactConstants,
        push: CompactPush,
        buffers: CompactBuffers,
        twin: compact_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 4 * w.get("gaussians") + 12 * w.get("visible"),
    }
}

fn compact_twin(call: Call<'_, Compact>) {
    let groups = call.group_count();
    let Call { constants, push, buffers: b, .. } = call;
    let words = splat_words(constants.packing);
    let frame: Frame = twin::struct_at(b.frame, 0);
    let gaussians = frame.gaussians;
    let mask = (1 << push.digit_bits) - 1;
    for group in 0..groups {
        let mut to = sum_before(b.visible_block, group * (COMPACT_GAUSSIANS / SCAN_BLOCK), push.block_capacity);
        let first = group * COMPACT_GAUSSIANS;
        for i in first..gaussians.min(first + COMPACT_GAUSSIANS) {
            if b.tile_count[i as usize] != 0 {
                let key = depth_key(b.splats[words * i as usize + 6], constants.depth_bits, &frame);
                b.keys[to as usize] = key;
                b.values[to as usize] = i;
                b.next_histogram[((to >> push.depth_partition_shift) * SORT_DIGITS + (key & mask)) as usize] += 1;
                to += 1;
            }
        }
        if group == 0 {
            write_arguments(push, frame.instance_capacity, b.counters, b.indirect);
        }
    }
}

/// Key of the depth with bits `z`, as the shader makes it; `depth_bits` 0 stands for 32.
fn depth_key(z: u32, depth_bits: u32, frame: &Frame) -> u32 {
    if depth_bits == 0 {
        return z;
    }
    let low = frame.world_to_camera_0[3].to_bits();
    ((z - z.min(low)) >> frame.world_to_camera_1[3] as u32).min((1 << depth_bits) - 1)
}

fn write_arguments(push: CompactPush, capacity: u32, counters: &mut [u32], indirect: &mut [u32]) {
    let total = counters[COUNT_INSTANCES_LOW as usize];
    let before = counters[COUNT_FAILED as usize] != 0;
    let failed = before || counters[COUNT_INSTANCES_HIGH as usize] != 0 || total > capacity;
    let visible = if failed { 0 } else { counters[COUNT_VISIBLE as usize] };
    let instances = if failed { 0 } else { total };
    for (at, items, per_group) in [
        (INDIRECT_DEPTH_SORT, visible, 1 << push.depth_partition_shift),
        (INDIRECT_EMIT, visible, SCAN_BLOCK),
        (INDIRECT_TILE_SORT, instances, 1 << push.tile_partition_shift),
        (INDIRECT_RANGES, instances, SCAN_BLOCK),
    ] {
        let [x, y, z] = twin::folded_groups(items.div_ceil(per_group));
        indirect[at as usize..][..4].copy_from_slice(&[x, y, z, 0]);
    }
    counters[COUNT_INSTANCES as usize] = instances;
    counters[COUNT_FAILED as usize] |= if failed { FAILED_INSTANCES } else { 0 };
}

//! `compact`: the visible Gaussians, in index order, as (depth key, index) pairs for the depth sort, and the arguments
//! of the indirect dispatches that follow.

use super::frame::Frame;
use super::limits::*;
use super::splat::splat_words;
use super::twin;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};

crate::gpu_struct! {
    /// Push constants of `compact`.
    pub struct CompactPush {
        /// Where the super sums of `visible_block` start, in words: its capacity of block sums.
        pub block_capacity: u32,
        /// Width of the first depth digit.
        pub digit_bits: u32,
    }
}

/// Gaussians per workgroup of `compact`.
pub const COMPACT_GAUSSIANS: u32 = 1024;

/// Word of `indirect` where the depth sort's group counts are: ceil(visible / 4096).
pub const INDIRECT_DEPTH_SORT: u32 = 0;
/// The same for `sum_tile_counts` and `emit_tiles`: ceil(visible / 256).
pub const INDIRECT_EMIT: u32 = 4;
/// The same for the tile sort: ceil(instances / 4096).
pub const INDIRECT_TILE_SORT: u32 = 8;
/// The same for `tile_ranges`: ceil(instances / 256).
pub const INDIRECT_RANGES: u32 = 12;
/// Words of `indirect`.
pub const INDIRECT_WORDS: u32 = 16;

/// Stable compaction. Dispatch ceil(gaussians / 1024) workgroups; `next_histogram` must be zero.
pub static COMPACT: Kernel = Kernel {
    name: "compact",
    doc: "packs the visible Gaussians into (depth key, index) pairs in index order, counts the first depth digit, \
          writes indirect arguments and the capacity failure",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "DEPTH_BITS", "PACKING"],
    push: CompactPush::FIELDS,
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("tile_count", Access::Read, Element::U32),
        Binding::new("splats", Access::Read, Element::F32),
        Binding::new("visible_block", Access::Read, Element::U32),
        Binding::new("counters", Access::Atomic, Element::U32),
        Binding::new("indirect", Access::Write, Element::U32),
        Binding::new("keys", Access::Write, Element::U32),
        Binding::new("values", Access::Write, Element::U32),
        Binding::new("next_histogram", Access::Atomic, Element::U32),
    ],
    twin: compact_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 4 * w.get("gaussians") + 12 * w.get("visible"),
    spirv: include_bytes!("../../../spirv_cache/compact.spv"),
};

fn compact_twin(call: &mut TwinCall<'_>) {
    let push: CompactPush = twin::push(call);
    let groups = twin::group_count(call);
    let (depth_bits, words) = (twin::spec(call, 1), splat_words(twin::spec(call, 2)));
    let [frame, tile_count, splats, visible_block, counters, indirect, keys, values, histogram] = call.buffers else {
        return;
    };
    let frame: Frame = twin::struct_at(frame, 0);
    let gaussians = frame.gaussians;
    let mask = (1 << push.digit_bits) - 1;
    for group in 0..groups {
        let mut to = sum_before(visible_block, group * (COMPACT_GAUSSIANS / SCAN_BLOCK), push.block_capacity);
        let first = group * COMPACT_GAUSSIANS;
        for i in first..gaussians.min(first + COMPACT_GAUSSIANS) {
            if tile_count[i as usize] != 0 {
                let key = depth_key(splats[words * i as usize + 6], depth_bits, &frame);
                keys[to as usize] = key;
                values[to as usize] = i;
                histogram[(to / SORT_PARTITION * SORT_DIGITS + (key & mask)) as usize] += 1;
                to += 1;
            }
        }
        if group == 0 {
            write_arguments(frame.instance_capacity, counters, indirect);
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

/// Sum of the block sums before `block`, from super sums and the blocks of the same super block.
pub(super) fn sum_before(sums: &[u32], block: u32, block_capacity: u32) -> u32 {
    let super_block = block / SCAN_SUPER;
    let blocks = super_block * SCAN_SUPER..block.min(block_capacity);
    let supers = block_capacity..block_capacity + super_block.min(block_capacity.div_ceil(SCAN_SUPER));
    supers.chain(blocks).map(|i| sums[i as usize]).sum()
}

fn write_arguments(capacity: u32, counters: &mut [u32], indirect: &mut [u32]) {
    let total = counters[COUNT_INSTANCES_LOW as usize];
    let failed = counters[COUNT_INSTANCES_HIGH as usize] != 0 || total > capacity;
    let visible = if failed { 0 } else { counters[COUNT_VISIBLE as usize] };
    let instances = if failed { 0 } else { total };
    for (at, items, per_group) in [
        (INDIRECT_DEPTH_SORT, visible, SORT_PARTITION),
        (INDIRECT_EMIT, visible, SCAN_BLOCK),
        (INDIRECT_TILE_SORT, instances, SORT_PARTITION),
        (INDIRECT_RANGES, instances, SCAN_BLOCK),
    ] {
        let [x, y, z] = twin::folded_groups(items.div_ceil(per_group));
        indirect[at as usize..][..4].copy_from_slice(&[x, y, z, 0]);
    }
    counters[COUNT_INSTANCES as usize] = instances;
    counters[COUNT_FAILED as usize] |= if failed { FAILED_INSTANCES } else { 0 };
}

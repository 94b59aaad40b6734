//! From depth-sorted Gaussians to tile lists: `sum_tile_counts`, `emit_tiles` and, after the tile sort, `tile_ranges`.

use super::compact::sum_before;
use super::ellipse::Ellipse;
use super::frame::Frame;
use super::limits::*;
use super::splat::unpack_splat;
use super::twin;
use crate::error::Result;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::gpu::{Buffer, Gpu, Memory};

crate::gpu_struct! {
    /// Push constants of `sum_tile_counts`.
    pub struct SumTileCountsPush {
        /// Where the super sums of `instance_block` start, in words: its capacity of block sums.
        pub block_capacity: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of `emit_tiles`.
    pub struct EmitTilesPush {
        /// Where the super sums of `instance_block` start, in words.
        pub block_capacity: u32,
        /// Width of the first tile digit.
        pub digit_bits: u32,
    }
}

/// Key bits of the tile sort: tile ids 0..`tile_count` and the sentinel `tile_count` itself.
pub fn tile_key_bits(tile_count: u32) -> u32 {
    (u32::BITS - tile_count.leading_zeros()).max(1)
}

/// Words of a `visible_block` or `instance_block` buffer for `elements` Gaussians, and its `block_capacity`.
pub fn block_words(elements: u32) -> (u32, u32) {
    let blocks = elements.div_ceil(SCAN_BLOCK).max(1);
    (blocks + blocks.div_ceil(SCAN_SUPER), blocks)
}

/// Block sums of tile counts. Dispatch ceil(visible / 256) workgroups; `instance_block` must be zero.
pub static SUM_TILE_COUNTS: Kernel = Kernel {
    name: "sum_tile_counts",
    doc: "sums tile counts over blocks of 256 depth-sorted Gaussians and over 256 blocks",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: SumTileCountsPush::FIELDS,
    bindings: &[
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("tile_count", Access::Read, Element::U32),
        Binding::new("order", Access::Read, Element::U32),
        Binding::new("instance_block", Access::Atomic, Element::U32),
    ],
    twin: sum_tile_counts_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 8 * w.get("visible"),
    spirv: include_bytes!("../../../spirv_cache/sum_tile_counts.spv"),
};

fn visible_of(counters: &[u32]) -> u32 {
    if counters[COUNT_FAILED as usize] == 0 { counters[COUNT_VISIBLE as usize] } else { 0 }
}

fn sum_tile_counts_twin(call: &mut TwinCall<'_>) {
    let push: SumTileCountsPush = twin::push(call);
    let groups = twin::group_count(call);
    let [counters, tile_count, order, instance_block] = call.buffers else { return };
    let visible = visible_of(counters);
    for group in 0..groups.min(visible.div_ceil(SCAN_BLOCK)) {
        let first = group * SCAN_BLOCK;
        let block = first..visible.min(first + SCAN_BLOCK);
        let total: u32 = block.map(|i| tile_count[order[i as usize] as usize]).sum();
        instance_block[group as usize] = total;
        instance_block[(push.block_capacity + group / SCAN_SUPER) as usize] += total;
    }
}

/// Where training finds the instances of a Gaussian: slot = position in the order of emission, in which they follow one
/// another (`tile_count` of them from `first_slot` on). With slots, the tile lists hold slots instead of Gaussians.
#[derive(Debug, Clone)]
pub struct SlotBuffers {
    /// `uint[instance capacity]`.
    pub gaussian_of_slot: Buffer,
    /// `uint[N]`; undefined for a Gaussian that is not visible.
    pub first_slot: Buffer,
}

impl SlotBuffers {
    /// Buffers for `gaussians` and at most `instances` (Gaussian, tile) pairs.
    ///
    /// # Errors
    /// `OutOfMemory` and the like.
    pub fn new(gpu: &Gpu, gaussians: u32, instances: u32) -> Result<Self> {
        let words = |name: &str, n: u32| gpu.buffer(name, u64::from(n.max(1)) * 4, Memory::Device);
        Ok(Self {
            gaussian_of_slot: words("gaussian_of_slot", instances)?,
            first_slot: words("first_slot", gaussians)?,
        })
    }
}

/// Tile instances in depth order. Dispatch ceil(visible / 256) workgroups; `next_histogram` must be zero. `WITH_SLOTS`: see
/// [`SlotBuffers`]; without, the last two bindings are dummies of any size.
pub static EMIT_TILES: Kernel = Kernel {
    name: "emit_tiles",
    doc: "writes one (tile, Gaussian) pair for each tile a visible Gaussian reaches, in depth order, and counts the \
          first tile digit",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "WITH_SLOTS", "ALPHA_CUT", "TILE_CULL", "PACKING"],
    push: EmitTilesPush::FIELDS,
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("tile_count", Access::Read, Element::U32),
        Binding::new("order", Access::Read, Element::U32),
        Binding::new("splats", Access::Read, Element::F32),
        Binding::new("instance_block", Access::Read, Element::U32),
        Binding::new("keys", Access::Write, Element::U32),
        Binding::new("values", Access::Write, Element::U32),
        Binding::new("next_histogram", Access::Atomic, Element::U32),
        Binding::new("gaussian_of_slot", Access::Write, Element::U32),
        Binding::new("first_slot", Access::Write, Element::U32),
    ],
    twin: emit_tiles_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 32 * w.get("visible") + 8 * w.get("instances"),
    spirv: include_bytes!("../../../spirv_cache/emit_tiles.spv"),
};

fn emit_tiles_twin(call: &mut TwinCall<'_>) {
    let push: EmitTilesPush = twin::push(call);
    let groups = twin::group_count(call);
    let with_slots = twin::spec(call, 1) == 1;
    let [alpha_cut, tile_cull, packing] = [2, 3, 4].map(|id| twin::spec(call, id));
    let [frame, counters, tile_count, order, splats, instance_block, keys, values, histogram, of_slot, first_slot] =
        call.buffers
    else {
        return;
    };
    let visible = visible_of(counters);
    let frame: Frame = twin::struct_at(frame, 0);
    let capacity = counters[COUNT_INSTANCES as usize].min(frame.instance_capacity);
    let mask = (1 << push.digit_bits) - 1;
    for group in 0..groups.min(visible.div_ceil(SCAN_BLOCK)) {
        let mut to = sum_before(instance_block, group, push.block_capacity);
        for i in group * SCAN_BLOCK..visible.min((group + 1) * SCAN_BLOCK) {
            let gaussian = order[i as usize];
            let g = gaussian as usize;
            let [first, second, _] = unpack_splat(packing, splats, g);
            let e = Ellipse::of_splat(first, second).with_constants(alpha_cut, tile_cull);
            if with_slots {
                first_slot[g] = to;
            }
            for tile in tiles_of(&e, tile_count[g], frame.size, frame.tile_count) {
                if to < capacity {
                    keys[to as usize] = tile;
                    values[to as usize] = if with_slots { to } else { gaussian };
                    if with_slots {
                        of_slot[to as usize] = gaussian;
                    }
                    histogram[(to / SORT_PARTITION * SORT_DIGITS + (tile & mask)) as usize] += 1;
                }
                to += 1;
            }
        }
    }
}

/// Exactly `count` tiles of an ellipse, row-major; `sentinel` stands for those that do not exist.
fn tiles_of(e: &Ellipse, count: u32, size: [u32; 4], sentinel: u32) -> Vec<u32> {
    let pixels = [size[0], size[1]];
    let mut tiles = Vec::new();
    let rows = e.tile_row_range(pixels);
    for row in rows[0]..rows[1] {
        let columns = e.tile_columns_of_row(row, pixels);
        tiles.extend((columns[0]..columns[1]).map(|column| row * size[2] + column));
    }
    tiles.resize(count as usize, sentinel);
    tiles
}

/// Where each tile's instances are. Dispatch ceil(instances / 256) workgroups; `ranges` must be zero.
pub static TILE_RANGES: Kernel = Kernel {
    name: "tile_ranges",
    doc: "finds the first and last + 1 instance of each tile in the tile-sorted instances",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: &[],
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("keys", Access::Read, Element::U32),
        Binding::new("ranges", Access::Write, Element::U32),
    ],
    twin: tile_ranges_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 4 * w.get("instances") + 8 * w.get("tiles"),
    spirv: include_bytes!("../../../spirv_cache/tile_ranges.spv"),
};

fn tile_ranges_twin(call: &mut TwinCall<'_>) {
    let threads = u64::from(twin::group_count(call)) * u64::from(SCAN_BLOCK);
    let [frame, counters, keys, ranges] = call.buffers else { return };
    let frame: Frame = twin::struct_at(frame, 0);
    let n = counters[COUNT_INSTANCES as usize] as usize;
    for i in 0..n.min(threads as usize) {
        let tile = keys[i];
        if tile >= frame.tile_count {
            continue;
        }
        if i == 0 || keys[i - 1] != tile {
            ranges[2 * tile as usize] = i as u32;
        }
        if i + 1 == n || keys[i + 1] != tile {
            ranges[2 * tile as usize + 1] = i as u32 + 1;
        }
    }
}

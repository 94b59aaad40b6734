//! Kernel `emit_tiles`: one (tile, Gaussian) pair for each tile that a visible Gaussian reaches.

use super::ellipse::{Ellipse, quadrants_of_tile};
use super::frame::Frame;
use super::limits::*;
use super::splat::unpack_splat;
use super::tiles::{sum_before, visible_of};
use super::twin;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_struct! {
    /// Push constants of [`EMIT_TILES`].
    pub struct EmitTilesPush {
        /// Where the super sums of `instance_block` start, in words.
        pub block_capacity: u32,
        /// Width of the first tile digit.
        pub digit_bits: u32,
        /// log2 of the keys of a partition of the tile sort.
        pub partition_shift: u32,
    }
}

crate::gpu_constants! {
    /// Specialisation constants of [`EMIT_TILES`].
    pub struct EmitTilesConstants {
        /// 1: the tile lists hold slots ([`SlotBuffers`](super::tiles::SlotBuffers)).
        with_slots,
        /// Least α that counts ([`Ellipse::with_constants`]).
        alpha_cut,
        /// How tiles are culled ([`Ellipse::with_constants`]).
        tile_cull,
        /// How splats are stored ([`super::splat`]).
        packing,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`EMIT_TILES`].
    pub struct EmitTilesBuffers {
        frame: Read Struct(Frame),
        counters: Read U32,
        /// `[N]`: tiles that each Gaussian reaches.
        tile_count: Read U32,
        /// `[visible]`: Gaussians by depth.
        order: Read U32,
        /// `[N]` splats ([`super::splat`]).
        splats: Read F32,
        /// Tile instances per block of 256, then per super block.
        instance_block: Read U32,
        /// `[instances]`: tiles.
        keys: Write U32,
        /// `[instances]`: instances ([`INSTANCE_GAUSSIAN`], [`INSTANCE_QUADRANT_SHIFT`]), or slots.
        values: Write U32,
        /// `[partition][256]` counts of the first tile digit; must be zero.
        next_histogram: Atomic U32,
        /// `[instances]`: instances; with slots only.
        gaussian_of_slot: optional Write U32,
        /// `[N]`; with slots only.
        first_slot: optional Write U32,
    }
}

crate::kernel! {
    /// Tile instances in depth order. Dispatch ceil(visible / 256) workgroups; `next_histogram` must be zero.
    pub static EMIT_TILES: EmitTiles = {
        name: "emit_tiles",
        doc: "writes one (tile, Gaussian) pair for each tile a visible Gaussian reaches, in depth order, and counts the \
              first tile digit",
        local_size: 256,
        constants: EmitTilesConstants,
        push: EmitTilesPush,
        buffers: EmitTilesBuffers,
        twin: emit_tiles_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 32 * w.get("visible") + 8 * w.get("instances"),
    }
}

fn emit_tiles_twin(call: Call<'_, EmitTiles>) {
    let groups = call.group_count();
    let Call { constants, push, buffers: mut b, .. } = call;
    let EmitTilesConstants { with_slots, alpha_cut, tile_cull, packing } = constants;
    let with_slots = with_slots == 1;
    let visible = visible_of(b.counters);
    let frame: Frame = twin::struct_at(b.frame, 0);
    let capacity = b.counters[COUNT_INSTANCES as usize].min(frame.instance_capacity);
    let mask = (1 << push.digit_bits) - 1;
    for group in 0..groups.min(visible.div_ceil(SCAN_BLOCK)) {
        let mut to = sum_before(b.instance_block, group, push.block_capacity);
        for i in group * SCAN_BLOCK..visible.min((group + 1) * SCAN_BLOCK) {
            let gaussian = b.order[i as usize];
            let g = gaussian as usize;
            let [first, second, _] = unpack_splat(packing, b.splats, g);
            let e = Ellipse::of_splat(first, second).with_constants(alpha_cut, tile_cull);
            if let Some(first_slot) = b.first_slot.as_mut().filter(|_| with_slots) {
                first_slot[g] = to;
            }
            for (tile, quadrants) in tiles_of(&e, b.tile_count[g], &frame) {
                if to < capacity {
                    let instance = gaussian | quadrants << INSTANCE_QUADRANT_SHIFT;
                    b.keys[to as usize] = tile;
                    b.values[to as usize] = if with_slots { to } else { instance };
                    if let Some(gaussian_of_slot) = b.gaussian_of_slot.as_mut().filter(|_| with_slots) {
                        gaussian_of_slot[to as usize] = instance;
                    }
                    b.next_histogram[((to >> push.partition_shift) * SORT_DIGITS + (tile & mask)) as usize] += 1;
                }
                to += 1;
            }
        }
    }
}

/// Exactly `count` tiles of an ellipse and their quadrants, row-major; one past the last tile stands for those that do not exist.
fn tiles_of(e: &Ellipse, count: u32, frame: &Frame) -> Vec<(u32, u32)> {
    let mut tiles = Vec::new();
    let rows = e.tile_row_range(frame.size);
    for row in rows[0]..rows[1] {
        let columns = e.tile_columns_of_row(row, frame.size);
        let half_rows = e.half_rows_of_tile_row(row);
        let tile = |column: u32| (row * frame.tiles[0] + column, quadrants_of_tile(half_rows, column));
        tiles.extend((columns[0]..columns[1]).map(tile));
    }
    tiles.resize(count as usize, (frame.tile_count, 0));
    tiles
}

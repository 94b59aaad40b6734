//! Kernel `emit_tiles`: appends each visible Gaussian to the list of each tile that it reaches.

use super::ellipse::{Ellipse, quadrants_of_tile};
use super::frame::Frame;
use super::limits::*;
use super::splat::unpack_splat;
use super::tiles::sum_before;
use super::twin;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_struct! {
    /// Push constants of [`EMIT_TILES`].
    pub struct EmitTilesPush {
        /// Where the super sums of `instance_block` start, in words.
        pub block_capacity: u32,
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
        /// `[N]` splats ([`super::splat`]).
        splats: Read F32,
        /// Tile instances per block of 256 Gaussians, then per super block.
        instance_block: Read U32,
        /// `[T+1]`: where the list of each tile begins, and the room of the one before ends.
        tile_start: Read U32,
        /// `[instances][2]`: bits of the depth, and an instance ([`INSTANCE_GAUSSIAN`], [`INSTANCE_QUADRANT_SHIFT`]) or its slot.
        pairs: Write U32,
        /// `[T+1][`[`TILE_PITCH`]`]`: the end of each tile's list, with what was left out because there was no room.
        tile_end: Atomic U32,
        /// `[instances]`: instances; with slots only.
        gaussian_of_slot: optional Write U32,
        /// `[N]`; with slots only.
        first_slot: optional Write U32,
    }
}

crate::kernel! {
    /// Pairs of depth and instance in the list of each tile, in any order. Dispatch ceil(N / 256) workgroups.
    pub static EMIT_TILES: EmitTiles = {
        name: "emit_tiles",
        doc: "appends each visible Gaussian to the list of each tile that it reaches, with its depth",
        local_size: 256,
        constants: EmitTilesConstants,
        push: EmitTilesPush,
        buffers: EmitTilesBuffers,
        twin: emit_tiles_twin,
        arrange: arrange_pairs,
        tolerance: Tolerance::EXACT,
        bytes: |w| 4 * w.get("gaussians") + 32 * w.get("visible") + 8 * w.get("instances"),
    }
}

/// Sorts the pairs of each tile, which come in whatever order its atomics had.
fn arrange_pairs(buffers: &mut [Vec<u32>]) {
    let [_, _, _, _, _, starts, pairs, ends, ..] = buffers else { return };
    for (room, end) in starts.windows(2).zip(ends.iter().step_by(TILE_PITCH as usize)) {
        let end = (*end).min(room[1]);
        let Some(list) = pairs.get_mut(2 * room[0] as usize..2 * end as usize) else { continue };
        let mut sorted: Vec<[u32; 2]> = list.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
        sorted.sort_unstable();
        list.copy_from_slice(sorted.as_flattened());
    }
}

fn emit_tiles_twin(call: Call<'_, EmitTiles>) {
    let groups = call.group_count();
    let Call { constants, push, buffers: mut b, .. } = call;
    let EmitTilesConstants { with_slots, alpha_cut, tile_cull, packing } = constants;
    let with_slots = with_slots == 1;
    let frame: Frame = twin::struct_at(b.frame, 0);
    let gaussians = if b.counters[COUNT_FAILED as usize] == 0 { frame.gaussians } else { 0 };
    for group in 0..groups.min(gaussians.div_ceil(SCAN_BLOCK)) {
        let mut slot = if with_slots { sum_before(b.instance_block, group, push.block_capacity) } else { 0 };
        for gaussian in group * SCAN_BLOCK..gaussians.min((group + 1) * SCAN_BLOCK) {
            let g = gaussian as usize;
            let count = b.tile_count[g];
            if count == 0 {
                continue;
            }
            let [first, second, _] = unpack_splat(packing, b.splats, g);
            let e = Ellipse::of_splat(first, second).with_constants(alpha_cut, tile_cull);
            if let Some(first_slot) = b.first_slot.as_mut().filter(|_| with_slots) {
                first_slot[g] = slot;
            }
            for ((tile, quadrants), own) in tiles_of(&e, count, &frame).into_iter().zip(slot..) {
                let instance = gaussian | quadrants << INSTANCE_QUADRANT_SHIFT;
                if let Some(gaussian_of_slot) = b.gaussian_of_slot.as_mut().filter(|_| with_slots) {
                    gaussian_of_slot[own as usize] = instance;
                }
                let end = &mut b.tile_end[tile * TILE_PITCH as usize];
                if *end < b.tile_start[tile + 1] {
                    let pair = [second[2].to_bits(), if with_slots { own } else { instance }];
                    b.pairs[2 * *end as usize..2 * *end as usize + 2].copy_from_slice(&pair);
                }
                *end += 1;
            }
            slot += count;
        }
    }
}

/// At most `count` tiles of an ellipse and their quadrants, row-major.
pub(super) fn tiles_of(e: &Ellipse, count: u32, frame: &Frame) -> Vec<(usize, u32)> {
    let mut tiles = Vec::new();
    let rows = e.tile_row_range(frame.size);
    for row in rows[0]..rows[1] {
        let columns = e.tile_columns_of_row(row, frame.size);
        let half_rows = e.half_rows_of_tile_row(row);
        let tile = |column: u32| ((row * frame.tiles[0] + column) as usize, quadrants_of_tile(half_rows, column));
        tiles.extend((columns[0]..columns[1]).map(tile));
    }
    tiles.truncate(count as usize);
    tiles
}

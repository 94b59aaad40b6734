//! Kernel `scan_tiles`: where the list of each tile begins.

use super::frame::Frame;
use super::limits::*;
use super::twin;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

/// Tiles that the workgroup has at a time.
pub const TILES_AT_ONCE: u32 = 4096;

/// Words of `tile_change` for so many tiles: a counter for each, and one for a change past the last tile.
pub fn tile_change_words(tiles: u32) -> u32 {
    (tiles + 1) * TILE_PITCH
}

crate::gpu_constants! {
    /// Specialisation constants of [`SCAN_TILES`].
    pub struct ScanTilesConstants {
        /// Lists of more pairs than that have a dispatch of their own, which `indirect` is for; 0: there is none.
        long,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SCAN_TILES`].
    pub struct ScanTilesBuffers {
        frame: Read Struct(Frame),
        /// In: instances and failure; out: instances to process, 0 when the frame failed, and the failure.
        counters: Atomic U32,
        /// `[T+1][`[`TILE_PITCH`]`]`. In: by how much the count of each tile differs from that of the tile before, row-major; out:
        /// where its list begins, which is the end that [`emit_tiles`](super::emit_tiles) moves.
        tile_change: Update U32,
        /// `[T+1]`: where the list of each tile begins; then where all lists end. Zeros when the frame failed.
        tile_start: Write U32,
        /// `[3]`: workgroups of the dispatch for long lists: one per tile, or none when no list is so long.
        indirect: optional Write U32,
    }
}

crate::kernel! {
    /// Starts of the tile lists from the changes of their lengths. Dispatch one workgroup.
    pub static SCAN_TILES: ScanTiles = {
        name: "scan_tiles",
        doc: "where the list of each tile begins, from what deform_project counted; checks that there is room for all",
        local_size: 256,
        constants: ScanTilesConstants,
        push: (),
        buffers: ScanTilesBuffers,
        twin: scan_tiles_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 16 * w.get("tiles"),
    }
}

fn scan_tiles_twin(call: Call<'_, ScanTiles>) {
    let Call { constants, buffers: mut b, .. } = call;
    let frame: Frame = twin::struct_at(b.frame, 0);
    let counted = b.counters[COUNT_INSTANCES_LOW as usize];
    let failed = b.counters[COUNT_INSTANCES_HIGH as usize] != 0
        || counted > frame.instance_capacity
        || b.counters[COUNT_FAILED as usize] != 0;
    let instances = if failed { 0 } else { counted };
    let (mut count, mut start, mut longest) = (0_u32, 0_u32, 0);
    for tile in 0..frame.tile_count as usize {
        let counter = &mut b.tile_change[tile * TILE_PITCH as usize];
        count = count.wrapping_add(*counter);
        longest = longest.max(count);
        *counter = start.min(instances);
        b.tile_start[tile] = *counter;
        start = start.wrapping_add(count);
    }
    b.tile_start[frame.tile_count as usize] = instances;
    if let Some(indirect) = b.indirect.as_mut().filter(|_| constants.long != 0) {
        let groups = if instances != 0 && longest > constants.long { frame.tile_count } else { 0 };
        let x = groups.min(65_535);
        indirect[..3].copy_from_slice(&[x, if x == 0 { 0 } else { groups.div_ceil(x) }, 1]);
    }
    b.counters[COUNT_INSTANCES as usize] = instances;
    b.counters[COUNT_FAILED as usize] = if failed { FAILED_INSTANCES } else { 0 };
}

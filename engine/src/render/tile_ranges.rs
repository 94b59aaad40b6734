//! Kernel `tile_ranges`: where each tile's instances are.

use super::frame::Frame;
use super::limits::{COUNT_INSTANCES, SCAN_BLOCK};
use super::twin;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_buffers! {
    /// Buffers of [`TILE_RANGES`].
    pub struct TileRangesBuffers {
        frame: Read Struct(Frame),
        counters: Read U32,
        /// `[instances]`: sorted tiles.
        keys: Read U32,
        /// `[tiles][2]`: first and last + 1 instance; must be zero.
        ranges: Write U32,
    }
}

crate::kernel! {
    /// Where each tile's instances are. Dispatch ceil(instances / 256) workgroups; `ranges` must be zero.
    pub static TILE_RANGES: TileRanges = {
        name: "tile_ranges",
        doc: "finds the first and last + 1 instance of each tile in the tile-sorted instances",
        local_size: 256,
        constants: (),
        push: (),
        buffers: TileRangesBuffers,
        twin: tile_ranges_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 4 * w.get("instances") + 8 * w.get("tiles"),
    }
}

fn tile_ranges_twin(call: Call<'_, TileRanges>) {
    let threads = u64::from(call.group_count()) * u64::from(SCAN_BLOCK);
    let TileRangesBuffers { frame, counters, keys, ranges } = call.buffers;
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

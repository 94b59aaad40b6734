//! Kernel `sort_tiles`: the order in which the list of each tile is blended.

use super::frame::Frame;
use super::limits::{COUNT_FAILED, INSTANCE_GAUSSIAN, TILE_PITCH};
use super::twin;
use crate::gpu::capability::DeviceInfo;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::subgroup_size::NVIDIA;

/// Most threads of a workgroup.
const MAX_THREADS: u32 = 256;
/// Pairs that a workgroup sorts at once; a longer list is cut first.
pub const SORT_TILES_CAPACITY: u32 = 2048;

crate::gpu_constants! {
    /// Specialisation constants of [`SORT_TILES`].
    pub struct SortTilesConstants {
        /// Bits of a pair's second word by which pairs of equal depth are ordered (all of slots, of instances the Gaussian).
        tie_mask,
        /// Threads of a workgroup.
        threads,
        /// Pairs of the shortest list that is sorted, at least 1.
        shortest,
        /// Pairs of the longest one.
        longest,
        /// Loads of a thread that are on their way together, at most 4.
        at_once,
    }
}

/// Pairs of a list, for each thread of a small workgroup, that llvmpipe sorts whatever the depths are: it ends all loops of an
/// invocation after 65,535 rounds together. A bitonic sort of 1,024 pairs per thread has 46,592, and with all others it is too much.
const PAIRS_OF_FEW_THREADS: u32 = 512;

/// Threads of a workgroup. On a CPU device, where a workgroup is run by one core and each barrier costs a switch between its
/// subgroups, one subgroup. On NVIDIA 128: what a workgroup does whatever the length of its list is half of the work for usual ones.
/// Elsewhere 256: shared memory limits how many workgroups are in flight, and by ACO twice as many threads are then (12 waves of
/// a SIMD of RDNA).
pub fn threads(info: &DeviceInfo, subgroup_size: u32) -> u32 {
    match info.vendor {
        _ if info.is_cpu() => subgroup_size,
        NVIDIA => 128,
        _ => MAX_THREADS,
    }
}

/// The dispatches that sort lists of at most so many pairs, which are the Gaussians. On a GPU one; on a CPU device long lists have one of
/// their own, with more threads.
pub fn dispatches(is_cpu: bool, threads: u32, most: u32, with_slots: bool) -> Vec<SortTilesConstants> {
    let tie_mask = tie_mask(with_slots);
    let all = SortTilesConstants { tie_mask, threads, shortest: 1, longest: u32::MAX, at_once: 4 };
    if !is_cpu {
        return vec![all];
    }
    let longest = PAIRS_OF_FEW_THREADS * threads;
    let short = SortTilesConstants { longest, at_once: 1, ..all };
    let long = SortTilesConstants { shortest: longest + 1, threads: MAX_THREADS, ..all };
    if long_from(is_cpu, threads, most) == 0 { vec![short] } else { vec![short, long] }
}

/// Lists with more pairs than that, of at most `most`, have a dispatch of their own, with the arguments that `scan_tiles` writes; 0:
/// there is none.
pub fn long_from(is_cpu: bool, threads: u32, most: u32) -> u32 {
    let longest = PAIRS_OF_FEW_THREADS * threads;
    if is_cpu && most > longest { longest } else { 0 }
}

/// Of instances the Gaussian counts, of slots all bits.
fn tie_mask(with_slots: bool) -> u32 {
    if with_slots { u32::MAX } else { INSTANCE_GAUSSIAN }
}

crate::gpu_buffers! {
    /// Buffers of [`SORT_TILES`].
    pub struct SortTilesBuffers {
        frame: Read Struct(Frame),
        /// `[T+1]`: where the list of each tile begins, and the room of the one before ends; without [`Frame::tile_room`].
        tile_start: optional Read U32,
        /// `[instances][2]`: bits of the depth, and an instance or its slot, in any order within a tile.
        pairs: Read U32,
        /// `[instances]`: the second words by depth within each tile, ties by themselves.
        values: Update U32,
        /// `[T+1][`[`TILE_PITCH`]`]`: the end of each tile's list, or, where pairs were left out, past its room.
        tile_end: Read U32,
        /// `[T][2]`: first and last + 1 instance of each tile.
        ranges: Write U32,
        /// With [`Frame::tile_room`]: whether there was too little of it.
        counters: Read U32,
    }
}

crate::kernel! {
    /// Sorts each tile's list by depth. Dispatch a workgroup per tile, as [`dispatches`] says.
    pub static SORT_TILES: SortTiles = {
        name: "sort_tiles",
        doc: "sorts the list of each tile by depth, ties by Gaussian: a workgroup per tile, in shared memory",
        local_size: MAX_THREADS,
        constants: SortTilesConstants,
        push: (),
        buffers: SortTilesBuffers,
        twin: sort_tiles_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 12 * w.get("instances") + 16 * w.get("tiles"),
    }
}

fn sort_tiles_twin(call: Call<'_, SortTiles>) {
    let Call { constants, buffers: b, .. } = call;
    let frame: Frame = twin::struct_at(b.frame, 0);
    for tile in 0..frame.tile_count as usize {
        let end = b.tile_end[tile * TILE_PITCH as usize];
        let range = match frame.tile_room {
            0 => {
                let starts = b.tile_start.as_deref().unwrap_or_default();
                [starts[tile], end.min(starts[tile + 1])]
            }
            room => {
                let kept = if b.counters[COUNT_FAILED as usize] == 0 { end.min(room) } else { 0 };
                [tile as u32 * room, tile as u32 * room + kept]
            }
        };
        b.ranges[2 * tile..2 * tile + 2].copy_from_slice(&range);
        let [first, end] = range.map(|at| at as usize);
        if !(constants.shortest as usize..=constants.longest as usize).contains(&(end - first)) {
            continue;
        }
        let mut list: Vec<[u32; 2]> = b.pairs[2 * first..2 * end].chunks_exact(2).map(|p| [p[0], p[1]]).collect();
        list.sort_by_key(|[depth, value]| (*depth, value & constants.tie_mask));
        b.values[first..end].iter_mut().zip(list).for_each(|(value, pair)| *value = pair[1]);
    }
}

//! How many tile instances the buffers hold, where the tile lists lie in them, what a frame counted, and how the buffers grow.
//!
//! Where that costs little memory, each tile has room of one size for its list: then nothing needs to know how long the others are, and
//! `deform_project` fills them. Otherwise the lists lie one behind the other (`scan_tiles`, `emit_tiles`).

use crate::error::{Error, Result};
use crate::gpu::Gpu;

use super::frame::Frame;
use super::limits::{
    COUNT_FAILED, COUNT_INSTANCES_HIGH, COUNT_INSTANCES_LOW, COUNT_LONGEST, COUNT_REJECTED, COUNT_VISIBLE,
};
use super::renderer::FrameStatistics;
use super::work_buffers::{COUNTER_WORDS, PAIR_BYTES};

/// Tile instances that the first frame has room for, per Gaussian.
const FIRST_INSTANCES_PER_GAUSSIAN: u64 = 2;
/// Room beyond what a frame needed when the buffers grow.
const GROWTH_PERCENT: u64 = 125;

/// Most bytes of pairs and values that lists with room of one size may take.
const ROOM_BYTES: u64 = 128 << 20;
/// Room of a list that the first frame has, in mean lists, and at least, in pairs.
const FIRST_MEAN_LISTS: u64 = 8;
const FIRST_ROOM: u64 = 256;
/// Room beyond the longest list. Lists grow faster than all instances do: where a camera goes away, few tiles have all.
const ROOM_PERCENT: u64 = 150;
/// The room is a multiple of this: lists begin at 256 bytes.
const ROOM_STEP: u64 = 32;

/// Instances that the first frame has room for.
pub(crate) fn first(gaussians: u32) -> u64 {
    (u64::from(gaussians) * FIRST_INSTANCES_PER_GAUSSIAN).max(4096)
}

/// Most tile instances that one binding of pairs holds, or that the caller allows.
pub(crate) fn limit(gpu: &Gpu, max_instances: Option<u64>) -> u64 {
    let c = &gpu.info().capabilities;
    let device = (c.max_storage_buffer_range.min(c.max_allocation_bytes) / PAIR_BYTES).min(1 << 31);
    max_instances.unwrap_or(u64::MAX).min(device)
}

/// The capacity for a view that needed this many instances.
pub(crate) fn grown(capacity: u64, needed: u64, limit: u64, gaussians: u32) -> Result<u64> {
    if needed > limit {
        let what = format!("tile instances of {gaussians} Gaussians in this view");
        return Err(Error::Limit { what, need: needed.into(), have: limit.into() });
    }
    Ok((needed * GROWTH_PERCENT / 100).clamp(capacity.min(limit), limit))
}

/// Where the tile lists lie and how much they hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Lists {
    /// All instances.
    pub(crate) instances: u32,
    /// Pairs that the list of each tile has room for; 0: they lie one behind the other.
    pub(crate) tile_room: u32,
}

impl Lists {
    /// Says so to the kernels.
    pub(crate) fn tell(self, frame: &mut Frame) {
        (frame.instance_capacity, frame.tile_room) = (self.instances, self.tile_room);
    }
}

/// What frames have shown to need.
#[derive(Debug)]
pub(crate) struct Capacity {
    gaussians: u32,
    /// Of lists that lie one behind the other.
    instances: u64,
    /// Of each tile's list; 0: nothing is known.
    room: u64,
    limit: u64,
    /// There was no memory for room of one size.
    packed: bool,
}

impl Capacity {
    /// For `gaussians` of which nothing is known; `max_instances`: what the caller allows.
    pub(crate) fn new(gpu: &Gpu, gaussians: u32, max_instances: Option<u64>) -> Self {
        Self::within(limit(gpu, max_instances), gaussians)
    }

    fn within(limit: u64, gaussians: u32) -> Self {
        Self { gaussians, instances: first(gaussians).min(limit), room: 0, limit, packed: false }
    }

    /// Another scene is drawn: what the one before needed stays.
    pub(crate) fn set_gaussians(&mut self, gaussians: u32) {
        self.gaussians = gaussians;
        self.instances = self.instances.max(first(gaussians)).min(self.limit);
    }

    /// The lists of an image of so many tiles.
    pub(crate) fn lists(&self, tiles: u32) -> Lists {
        let tiles = u64::from(tiles.max(1));
        let guess = (FIRST_MEAN_LISTS * first(self.gaussians) / tiles).max(FIRST_ROOM);
        // No Gaussian is twice in a list.
        let most = u64::from(self.gaussians.max(1)).next_multiple_of(ROOM_STEP);
        let room = if self.room == 0 { guess } else { self.room }.next_multiple_of(ROOM_STEP).min(most);
        let instances = tiles * room;
        if self.packed || instances > self.limit || instances * (PAIR_BYTES + 4) > ROOM_BYTES {
            return Lists { instances: self.instances as u32, tile_room: 0 };
        }
        Lists { instances: instances as u32, tile_room: room as u32 }
    }

    /// Memory is short: lists lie one behind the other from now on. Whether those of an image of so many tiles did not before.
    pub(crate) fn pack(&mut self, tiles: u32) -> bool {
        let saves = self.lists(tiles).tile_room != 0;
        self.packed |= saves;
        saves
    }

    /// What a frame counted; the next buffers have more room where it was scarce.
    pub(crate) fn learn(&mut self, counted: &Counted) -> Result<()> {
        let needed = counted.statistics.instances;
        if counted.overflowed {
            // A frame of before the last growth asks for nothing new.
            self.instances = grown(self.instances, needed, self.limit, self.gaussians)?.max(self.instances);
        }
        self.room = self.room.max(u64::from(counted.longest) * ROOM_PERCENT / 100);
        Ok(())
    }
}

/// What a frame left in the counters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Counted {
    /// It needed more instances than there was room for; its image is the background.
    pub(crate) overflowed: bool,
    /// The longest list, where each has room of its own and this one more than three quarters of it; or 0.
    pub(crate) longest: u32,
    pub(crate) statistics: FrameStatistics,
}

/// Reads the counters.
pub(crate) fn counted(bytes: &[u8; COUNTER_WORDS as usize * 4]) -> Counted {
    let word = |i: u32| u32::from_le_bytes([0, 1, 2, 3].map(|b| bytes[4 * i as usize + b]));
    let instances = u64::from(word(COUNT_INSTANCES_HIGH)) << 32 | u64::from(word(COUNT_INSTANCES_LOW));
    let statistics = FrameStatistics { visible: word(COUNT_VISIBLE), instances, rejected: word(COUNT_REJECTED) };
    Counted { overflowed: word(COUNT_FAILED) != 0, longest: word(COUNT_LONGEST), statistics }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    const LIMIT: u64 = 1 << 24;

    fn counted(overflowed: bool, longest: u32, instances: u64) -> Counted {
        Counted { overflowed, longest, statistics: FrameStatistics { visible: 1, instances, rejected: 0 } }
    }

    #[test]
    fn room_is_of_one_size_where_it_costs_little() {
        let capacity = Capacity::within(LIMIT, 120_000);
        // 8 lists of 96 pairs, in steps of 32.
        assert_eq!(capacity.lists(2500), Lists { instances: 2500 * 768, tile_room: 768 });
        // No list is longer than there are Gaussians.
        assert_eq!(Capacity::within(LIMIT, 100).lists(4), Lists { instances: 4 * 128, tile_room: 128 });
        // 1,048,576 tiles at 256 pairs are more than 128 MiB.
        assert_eq!(capacity.lists(1 << 20), Lists { instances: 240_000, tile_room: 0 });
        // More than the caller allows.
        assert_eq!(Capacity::within(5000, 120_000).lists(2500), Lists { instances: 5000, tile_room: 0 });
    }

    #[test]
    fn room_grows_before_it_is_too_small() {
        let mut capacity = Capacity::within(LIMIT, 120_000);
        let before = capacity.lists(2500);
        capacity.learn(&counted(false, 0, 400_000)).unwrap();
        assert_eq!(capacity.lists(2500), before);
        capacity.learn(&counted(false, 700, 400_000)).unwrap();
        assert_eq!(capacity.lists(2500).tile_room, 1056);
        capacity.learn(&counted(true, 2000, 900_000)).unwrap();
        assert_eq!(capacity.lists(2500).tile_room, 3008);
        // Lists that lie one behind the other have the room that was asked for meanwhile.
        assert_eq!(capacity.lists(25_000), Lists { instances: 1_125_000, tile_room: 0 });
        // Where they do already, there is nothing to save.
        assert!(!capacity.pack(25_000) && capacity.pack(2500) && !capacity.pack(2500));
        assert_eq!(capacity.lists(2500), Lists { instances: 1_125_000, tile_room: 0 });
    }

    #[test]
    fn what_can_never_fit_is_a_limit() {
        let mut capacity = Capacity::within(LIMIT, 120_000);
        let error = capacity.learn(&counted(true, 5000, LIMIT + 1)).unwrap_err();
        assert!(matches!(error, Error::Limit { need, .. } if need == u128::from(LIMIT) + 1), "{error}");
    }
}

//! Intermediate buffers of a frame and their sizes. One arena holds everything that must be zero at the start of a frame,
//! so that one fill clears it.

use crate::error::Result;
use crate::gpu::{Buffer, Gpu, Memory, SLICE_ALIGNMENT, Slice};

use super::scan_tiles::tile_change_words;
use super::tiles::block_words;

/// Bytes of a pair, the largest thing that there is for each tile instance.
pub(crate) const PAIR_BYTES: u64 = 8;
/// Words of `counters`.
pub(crate) const COUNTER_WORDS: u64 = 8;

/// Everything between the scene and the image.
#[derive(Debug)]
pub(crate) struct WorkBuffers {
    pub(crate) zeroed: Buffer,
    pub(crate) counters: Slice,
    /// What they counted in a frame that clears them at its end, for what looks at the frame on the device.
    pub(crate) counted: Buffer,
    pub(crate) instance_block: Slice,
    /// Of each tile first the change from the one before, then the end of its list.
    pub(crate) tile_counters: Slice,
    pub(crate) block_capacity: u32,
    pub(crate) splats: Buffer,
    pub(crate) tile_count: Buffer,
    /// Where the list of each tile begins; then where all end.
    pub(crate) tile_start: Buffer,
    /// Where the list of each tile begins and ends.
    pub(crate) ranges: Buffer,
    /// Workgroups of the dispatch for long lists.
    pub(crate) indirect: Buffer,
    /// Depth and instance, in any order within a tile.
    pub(crate) pairs: Buffer,
    /// The tile lists: per instance in tile order its Gaussian (or its slot), in depth order within a tile.
    pub(crate) values: Buffer,
}

impl WorkBuffers {
    /// Buffers for `gaussians`, `tiles` of the image and at most `instances` (Gaussian, tile) pairs.
    pub(crate) fn new(gpu: &Gpu, gaussians: u32, tiles: u32, instances: u32) -> Result<Self> {
        let (blocks, block_capacity) = block_words(gaussians);
        let parts = [
            ("counters", COUNTER_WORDS * 4),
            ("instance_block", u64::from(blocks) * 4),
            ("tile_counters", u64::from(tile_change_words(tiles)) * 4),
        ];
        let total: u64 = parts.iter().map(|(_, bytes)| bytes.next_multiple_of(SLICE_ALIGNMENT)).sum();
        let zeroed = gpu.buffer("zeroed", total, Memory::Device)?;
        let mut start = 0;
        let [counters, instance_block, tile_counters] = parts.map(|(name, bytes)| {
            let slice = zeroed.slice(start, bytes).named(name);
            start += bytes.next_multiple_of(SLICE_ALIGNMENT);
            slice
        });
        let words = |name: &str, count: u64| gpu.buffer(name, count.max(1) * 4, Memory::Device);
        Ok(Self {
            counters,
            counted: words("counted", COUNTER_WORDS)?,
            instance_block,
            tile_counters,
            block_capacity,
            splats: words("splats", 12 * u64::from(gaussians.max(1)))?,
            tile_count: words("tile_count", gaussians.into())?,
            tile_start: words("tile_start", u64::from(tiles) + 1)?,
            ranges: words("ranges", 2 * u64::from(tiles))?,
            indirect: words("indirect", 3)?,
            pairs: words("pairs", PAIR_BYTES / 4 * u64::from(instances.max(1)))?,
            values: words("values", instances.into())?,
            zeroed,
        })
    }

    /// Zeros what must be zero before a frame. Waits.
    pub(crate) fn clear(&self, gpu: &Gpu) -> Result<()> {
        let mut r = gpu.recorder("clear work buffers");
        r.fill(&self.zeroed, 0)?;
        gpu.run(r).map(drop)
    }

    /// Bytes that grow with the number of Gaussians, and bytes that grow with the number of tile instances.
    pub(crate) fn bytes(&self) -> (u64, u64) {
        let gaussians = self.splats.bytes() + self.tile_count.bytes() + self.instance_block.bytes;
        (gaussians, self.pairs.bytes() + self.values.bytes())
    }
}

//! Intermediate buffers of a frame and their sizes. One arena holds everything that must be zero at the start of a frame,
//! so that one fill clears it.

use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Memory, SLICE_ALIGNMENT, Slice};

use super::compact::INDIRECT_WORDS;
use super::radix_sort::SortPlan;
use super::tiles::{block_words, tile_key_bits};

/// Words of `counters`.
pub(crate) const COUNTER_WORDS: u64 = 8;
/// Bits of a depth key that is the whole positive float.
pub(crate) const DEPTH_KEY_BITS: u32 = 32;

/// Keys and values, twice, for a sort that goes back and forth.
#[derive(Debug)]
pub(crate) struct SortBuffers {
    pub(crate) plan: SortPlan,
    pub(crate) keys: [Buffer; 2],
    pub(crate) values: [Buffer; 2],
    /// One histogram per pass, inside the zeroed arena.
    pub(crate) histograms: Vec<Slice>,
}

/// Everything between the scene and the image.
#[derive(Debug)]
pub(crate) struct WorkBuffers {
    pub(crate) zeroed: Buffer,
    pub(crate) counters: Slice,
    pub(crate) visible_block: Slice,
    pub(crate) instance_block: Slice,
    pub(crate) ranges: Slice,
    pub(crate) block_capacity: u32,
    pub(crate) indirect: Buffer,
    pub(crate) splats: Buffer,
    pub(crate) tile_count: Buffer,
    pub(crate) depth: SortBuffers,
    pub(crate) tile: SortBuffers,
}

impl WorkBuffers {
    /// Buffers for `gaussians`, `tiles` of the image and at most `instances` (Gaussian, tile) pairs.
    pub(crate) fn new(gpu: &Gpu, gaussians: u32, tiles: u32, instances: u32) -> Result<Self> {
        Self::with_depth_bits(gpu, gaussians, tiles, instances, DEPTH_KEY_BITS)
    }

    /// The same for depth keys of `depth_bits` bits.
    pub(crate) fn with_depth_bits(
        gpu: &Gpu,
        gaussians: u32,
        tiles: u32,
        instances: u32,
        depth_bits: u32,
    ) -> Result<Self> {
        let depth_plan = SortPlan::for_device(gpu, gaussians.max(1), depth_bits)?;
        let tile_plan = SortPlan::for_device(gpu, instances.max(1), tile_key_bits(tiles))?;
        let (words, block_capacity) = block_words(gaussians);
        let block_bytes = u64::from(words) * 4;
        let mut sizes = vec![COUNTER_WORDS * 4, block_bytes, block_bytes, u64::from(tiles) * 8];
        let histograms = |plan: &SortPlan| vec![plan.histogram_bytes(); plan.digits.len()];
        sizes.extend(histograms(&depth_plan));
        sizes.extend(histograms(&tile_plan));
        let total: u64 = sizes.iter().map(|s| s.next_multiple_of(SLICE_ALIGNMENT)).sum();
        let zeroed = gpu.buffer("zeroed", total, Memory::Device)?;
        let mut start = 0;
        let mut slices = sizes.into_iter().map(|bytes| {
            let slice = zeroed.slice(start, bytes);
            start += bytes.next_multiple_of(SLICE_ALIGNMENT);
            slice
        });
        let mut next = || slices.next().ok_or_else(|| Error::usage("zeroed arena", "too few parts", "one per buffer"));
        let counters = next()?.named("counters");
        let visible_block = next()?.named("visible_block");
        let instance_block = next()?.named("instance_block");
        let ranges = next()?.named("ranges");
        let depth_histograms =
            depth_plan.digits.iter().map(|_| Ok(next()?.named("depth_histogram"))).collect::<Result<_>>()?;
        let tile_histograms =
            tile_plan.digits.iter().map(|_| Ok(next()?.named("tile_histogram"))).collect::<Result<_>>()?;
        drop(slices);
        let word = |name: &str, count: u32| gpu.buffer(name, u64::from(count.max(1)) * 4, Memory::Device);
        let sort = |names: [&str; 4], plan: SortPlan, histograms| {
            let n = plan.capacity;
            let keys = [word(names[0], n)?, word(names[1], n)?];
            let values = [word(names[2], n)?, word(names[3], n)?];
            Ok::<_, Error>(SortBuffers { plan, keys, values, histograms })
        };
        Ok(Self {
            counters,
            visible_block,
            instance_block,
            ranges,
            block_capacity,
            indirect: word("indirect", INDIRECT_WORDS)?,
            splats: gpu.buffer("splats", u64::from(gaussians.max(1)) * 48, Memory::Device)?,
            tile_count: word("tile_count", gaussians)?,
            depth: sort(
                ["depth_keys_a", "depth_keys_b", "depth_values_a", "depth_values_b"],
                depth_plan,
                depth_histograms,
            )?,
            tile: sort(["tile_keys_a", "tile_keys_b", "tile_values_a", "tile_values_b"], tile_plan, tile_histograms)?,
            zeroed,
        })
    }

    /// The tile lists: per instance in tile order its Gaussian (or its slot), in depth order within a tile.
    pub(crate) fn tile_values(&self) -> &Buffer {
        &self.tile.values[self.tile.plan.result_in()]
    }

    /// Bytes that grow with the number of Gaussians, and bytes that grow with the number of tile instances.
    pub(crate) fn bytes(&self) -> (u64, u64) {
        let sort = |s: &SortBuffers| {
            let arrays = s.keys.iter().chain(&s.values).map(Buffer::bytes).sum::<u64>();
            arrays + s.histograms.iter().map(|h| h.bytes).sum::<u64>()
        };
        let blocks = self.visible_block.bytes + self.instance_block.bytes;
        (self.splats.bytes() + self.tile_count.bytes() + blocks + sort(&self.depth), sort(&self.tile))
    }
}

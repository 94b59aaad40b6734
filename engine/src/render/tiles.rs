//! What the kernels that make the tile lists share: sums over blocks of Gaussians, slots of instances.

use super::limits::*;
use crate::error::Result;
use crate::gpu::{Buffer, Gpu, Memory};

/// Tiles of an image of so many pixels.
pub(crate) fn tiles_of([width, height]: [u32; 2]) -> u32 {
    width.div_ceil(TILE_SIZE) * height.div_ceil(TILE_SIZE)
}

/// Words of `instance_block` for `elements` Gaussians, and its `block_capacity`.
pub fn block_words(elements: u32) -> (u32, u32) {
    let blocks = elements.div_ceil(SCAN_BLOCK).max(1);
    (blocks + blocks.div_ceil(SCAN_SUPER), blocks)
}

/// Sum of the block sums before `block`, from super sums and the blocks of the same super block.
pub(super) fn sum_before(sums: &[u32], block: u32, block_capacity: u32) -> u32 {
    let super_block = block / SCAN_SUPER;
    let blocks = super_block * SCAN_SUPER..block.min(block_capacity);
    let supers = block_capacity..block_capacity + super_block.min(block_capacity.div_ceil(SCAN_SUPER));
    supers.chain(blocks).map(|i| sums[i as usize]).sum()
}

/// Where training finds the instances of a Gaussian: slots number all instances in the order of Gaussians, so that those of one follow
/// one another (`tile_count` of them from `first_slot` on). With slots, the tile lists hold slots instead of Gaussians.
#[derive(Debug, Clone)]
pub struct SlotBuffers {
    /// `uint[instance capacity]`: instances, that is Gaussians and the quadrants that they reach
    /// ([`INSTANCE_GAUSSIAN`](super::limits::INSTANCE_GAUSSIAN)).
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

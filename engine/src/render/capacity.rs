//! How many tile instances the buffers hold, what a frame counted, and how the buffers grow.

use crate::error::{Error, Result};
use crate::gpu::Gpu;

use super::limits::{COUNT_FAILED, COUNT_INSTANCES_HIGH, COUNT_INSTANCES_LOW, COUNT_REJECTED, COUNT_VISIBLE};
use super::renderer::FrameStatistics;
use super::work_buffers::{COUNTER_WORDS, PAIR_BYTES};

/// Tile instances that the first frame has room for, per Gaussian.
const FIRST_INSTANCES_PER_GAUSSIAN: u64 = 2;
/// Room beyond what a frame needed when the buffers grow.
const GROWTH_PERCENT: u64 = 125;

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

/// What a frame left in the counters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Counted {
    /// It needed more instances than there was room for; its image is the background.
    pub(crate) overflowed: bool,
    pub(crate) statistics: FrameStatistics,
}

/// Reads the counters.
pub(crate) fn counted(bytes: &[u8; COUNTER_WORDS as usize * 4]) -> Counted {
    let word = |i: u32| u32::from_le_bytes([0, 1, 2, 3].map(|b| bytes[4 * i as usize + b]));
    let instances = u64::from(word(COUNT_INSTANCES_HIGH)) << 32 | u64::from(word(COUNT_INSTANCES_LOW));
    let statistics = FrameStatistics { visible: word(COUNT_VISIBLE), instances, rejected: word(COUNT_REJECTED) };
    Counted { overflowed: word(COUNT_FAILED) != 0, statistics }
}

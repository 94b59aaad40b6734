//! Segments of the tiles' lists: what lets the backward pass walk a long list in several places at once.
//!
//! A small image has few tiles, and each has a list of thousands of splats. One subgroup after another splat leaves a GPU empty
//! (measured at 100×100 px on an H200: 1.5 ms of a step of 2.2 ms), so training cuts each list into [`Segments`], and
//! [`blend_states`](super::blend_states) keeps what a pixel is at the beginning of each. An image of many tiles fills the device
//! by itself: its lists stay whole, and nothing is kept.

use crate::error::Result;
use crate::gpu::{Gpu, Memory, Slice};
use crate::render::tiles::tiles_of;

/// Splats by which the length of a segment grows: at every subgroup size a segment begins with a batch.
pub const SEGMENT_STEP: u32 = 128;
/// Splats of a segment below which another one is not worth its start.
pub const LEAST_SEGMENT: u32 = 256;
/// Segments of an image that fill a GPU.
pub const WANTED_SEGMENTS: u32 = 2048;
/// Most segments of a list.
pub const MOST_SEGMENTS: u32 = 32;

/// How the lists of an image are cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segments {
    /// Most of a list; 1: lists stay whole.
    pub per_list: u32,
    /// Least splats of one, but for the last of a list.
    pub least: u32,
}

impl Segments {
    /// Lists stay whole.
    pub const WHOLE: Self = Self { per_list: 1, least: LEAST_SEGMENT };

    /// For an image of so many tiles on a GPU. Powers of two: each number is another pipeline.
    pub fn of_tiles(tiles: u32) -> Self {
        let per_list = WANTED_SEGMENTS.div_ceil(tiles.max(1)).next_power_of_two().min(MOST_SEGMENTS);
        Self { per_list, ..Self::WHOLE }
    }

    /// Splats of a segment of a list; of the last one, at most.
    pub fn length(self, splats: usize) -> usize {
        let even = splats.div_ceil(self.per_list as usize);
        even.max(self.least as usize).next_multiple_of(SEGMENT_STEP as usize)
    }

    /// Bytes of the states of an image of so many pixels: none in front of a list's first segment.
    pub fn state_bytes(self, pixels: u64) -> u64 {
        16 * pixels * u64::from(self.per_list - 1)
    }
}

/// What the forward pass leaves for the segments of an image.
#[derive(Debug, Clone)]
pub struct States {
    /// How the lists are cut: more than one segment each.
    pub segments: Segments,
    /// `vec4[(per_list − 1)·H·W]`: colour so far and transmittance, negative once closed.
    pub buffer: Slice,
}

impl States {
    /// Room for the states of an image, in case its lists are cut on this device.
    ///
    /// # Errors
    /// `OutOfMemory`, `Limit`.
    pub(crate) fn of_device(gpu: &Gpu, [width, height]: [u32; 2]) -> Result<Option<Self>> {
        let segments = Segments::of_tiles(tiles_of([width, height]));
        // A CPU has few subgroups at a time.
        if gpu.info().is_cpu() || segments.per_list == 1 {
            return Ok(None);
        }
        Self::new(gpu, segments, u64::from(width) * u64::from(height)).map(Some)
    }

    /// For more than one segment.
    ///
    /// # Errors
    /// `OutOfMemory`, `Limit`.
    pub(crate) fn new(gpu: &Gpu, segments: Segments, pixels: u64) -> Result<Self> {
        let buffer = gpu.buffer("states", segments.state_bytes(pixels).max(16), Memory::Device)?;
        Ok(Self { segments, buffer: Slice::from(&buffer) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_images_are_cut_and_large_ones_are_not() {
        for (tiles, per_list) in [(0, 32), (1, 32), (4, 32), (49, 32), (100, 32), (400, 8), (625, 4), (2048, 1)] {
            assert_eq!(Segments::of_tiles(tiles).per_list, per_list, "{tiles} tiles");
        }
        assert_eq!(Segments::of_tiles(2500), Segments::WHOLE);
    }

    #[test]
    fn segments_cover_a_list_in_whole_batches() {
        for (per_list, least) in [(1, 256), (2, 1), (8, 128), (32, 300)] {
            let segments = Segments { per_list, least };
            for splats in [0, 1, 127, 128, 129, 1000, 4095, 4097, 1 << 20] {
                let length = segments.length(splats);
                assert!(length * per_list as usize >= splats && length >= least as usize, "{segments:?}, {splats}");
                assert!(length.is_multiple_of(128), "{segments:?}, {splats}");
            }
        }
        assert_eq!(Segments { per_list: 4, least: 128 }.state_bytes(100), 4800);
    }
}

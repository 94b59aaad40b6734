//! What a view looks like, where it goes, and what came of it.

use super::super::pixel_format::PixelFormat;
use super::super::renderer::FrameStatistics;
use crate::gpu::HostImage;

/// Most frames in flight.
pub(super) const MAX_IN_FLIGHT: u32 = 16;

/// What a view looks like.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewOptions {
    /// Colour behind everything; black for premultiplied colour to be put over something else.
    pub background: [f32; 3],
    /// Gaussians at camera depth z ≤ near are not drawn; world units.
    pub near: f32,
    /// Format of the colour image.
    pub format: PixelFormat,
    /// Whether the colour image is written through a storage view
    /// ([`HostImage::with_storage_view`](crate::gpu::HostImage::with_storage_view)): no copy follows the frame. Not with [`PixelFormat::Bgra8`].
    pub storage: bool,
    /// Whether depth is rendered too (see the [module's page](super)).
    pub depth: bool,
    /// Calls of [`View::record`](super::View::record) whose commands may not have finished when the next one is made, plus one: with two frames
    /// in flight and one call per frame, 2. At most 16.
    pub in_flight: u32,
    /// Largest number of tile instances; `None`: what the device's buffers can hold.
    pub max_instances: Option<u64>,
    /// Whether timestamps are taken around every operation.
    pub profile: bool,
}

impl Default for ViewOptions {
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            near: 0.2,
            format: PixelFormat::Rgba8,
            storage: false,
            depth: false,
            in_flight: 2,
            max_instances: None,
            profile: false,
        }
    }
}

/// Where a frame goes. Both images are at least as large as the camera's.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Colour, in the view's format; with a storage view if, and only if, the view wants one.
    pub color: HostImage,
    /// Depth, `R32_SFLOAT`; only of a view with depth.
    pub depth: Option<HostImage>,
}

/// What became of an earlier frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finished {
    /// Which call of [`View::record`](super::View::record) it was, counted from 1; frames of warming up do not count.
    pub serial: u64,
    /// What it counted.
    pub statistics: FrameStatistics,
    /// It needed more tile instances than there was room for, and shows the background only; there is room now.
    pub overflowed: bool,
}

/// What [`View::record`](super::View::record) did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Recorded {
    /// Number of this call, counted from 1.
    pub serial: u64,
    /// The frame of `in_flight` calls ago; `None` in the first calls, or when its command buffer was never executed.
    pub finished: Option<Finished>,
}

//! Everything of a training step whose size follows the image: one [`Target`] per image size of the data set.

use super::blend_backward::ROW_WORDS;
use super::image_loss::{LOSS_WORDS, LossPass};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Commands, Gpu, Memory};
use crate::render::limits::TILE_SIZE;
use crate::render::pipeline::{FrameBuffers, Shape};
use crate::render::tiles::SlotBuffers;
use crate::render::work_buffers::WorkBuffers;

/// What a recording of the step depends on besides buffers; another one needs another recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RecordingKey {
    pub(crate) sh_degree: u32,
    pub(crate) moves: bool,
}

/// Buffers of a step for one image size.
#[derive(Debug)]
pub(crate) struct Target {
    pub(crate) size: [u32; 2],
    /// Tile instances that there is room for.
    pub(crate) capacity: u32,
    pub(crate) work: WorkBuffers,
    pub(crate) frame: FrameBuffers,
    pub(crate) shape: Shape,
    /// Gradient rows per instance; only with slots.
    pub(crate) instance_gradient: Option<Buffer>,
    /// Premultiplied RGBA8 of the photo, host side.
    pub(crate) upload: Buffer,
    /// The same on the device.
    pub(crate) photo: Buffer,
    pub(crate) image_gradient: Buffer,
    pub(crate) loss: Buffer,
    pub(crate) image_loss: LossPass,
    pub(crate) commands: Option<(RecordingKey, Commands)>,
}

/// Sizes of a target.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TargetSize {
    pub(crate) image: [u32; 2],
    pub(crate) gaussians: u32,
    pub(crate) capacity: u32,
    pub(crate) with_slots: bool,
    pub(crate) with_ssim: bool,
}

impl Target {
    /// Allocates all buffers.
    ///
    /// # Errors
    /// `OutOfMemory`, `Limit`.
    pub(crate) fn new(gpu: &Gpu, size: TargetSize) -> Result<Self> {
        let [width, height] = size.image;
        if width == 0 || height == 0 {
            return Err(Error::usage("training image", format!("{width}×{height}"), "at least 1×1 pixels"));
        }
        let tiles = width.div_ceil(TILE_SIZE) * height.div_ceil(TILE_SIZE);
        let pixels = u64::from(width) * u64::from(height);
        let device = |name: &str, bytes: u64| gpu.buffer(name, bytes, Memory::Device);
        let slots = size.with_slots.then(|| SlotBuffers::new(gpu, size.gaussians, size.capacity)).transpose()?;
        let row_bytes = u64::from(size.capacity.max(1)) * u64::from(ROW_WORDS) * 4;
        Ok(Self {
            size: size.image,
            capacity: size.capacity,
            work: WorkBuffers::new(gpu, size.gaussians, tiles, size.capacity)?,
            frame: FrameBuffers {
                frame: gpu.buffer("frame", size_of::<crate::render::frame::Frame>() as u64, Memory::Constants)?,
                host_pose: None,
                color: device("color", pixels * 16)?,
                depth: None,
                counters: gpu.buffer("counters readback", 32, Memory::Readback)?,
            },
            instance_gradient: slots.as_ref().map(|_| device("instance_gradient", row_bytes)).transpose()?,
            shape: Shape { tiles, with_depth: false, slots, ..Shape::default() },
            upload: gpu.buffer("photo upload", pixels * 4, Memory::Upload)?,
            photo: device("target", pixels * 4)?,
            image_gradient: device("image_gradient", pixels * 16)?,
            loss: device("loss", LOSS_WORDS as u64 * 4)?,
            image_loss: LossPass::new(gpu, width, height, size.with_ssim)?,
            commands: None,
        })
    }
}

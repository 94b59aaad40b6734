//! Everything of a training step whose size follows the image: one [`Target`] per image size of the data set.

use super::blend_backward::ROW_WORDS;
use super::exposure::ExposurePass;
use super::image_loss::{LOSS_WORDS, LossPass};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Commands, Gpu, Memory};
use crate::render::frame::Frame;
use crate::render::pipeline::{FrameBuffers, Shape};
use crate::render::segments::States;
use crate::render::tiles::{SlotBuffers, tiles_of};
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
    /// One per step in flight: image and counters are shared.
    pub(crate) frames: Vec<FrameBuffers>,
    pub(crate) shape: Shape,
    /// Gradient rows per instance; only with slots.
    pub(crate) instance_gradient: Option<Buffer>,
    pub(crate) image_gradient: Buffer,
    pub(crate) loss: Buffer,
    pub(crate) image_loss: LossPass,
    /// Only where photos have exposures.
    pub(super) exposure: Option<ExposurePass>,
    /// One per step in flight.
    pub(crate) commands: Vec<Option<(RecordingKey, Commands)>>,
}

/// Sizes of a target.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TargetSize {
    pub(crate) image: [u32; 2],
    pub(crate) gaussians: u32,
    pub(crate) capacity: u32,
    pub(crate) with_slots: bool,
    pub(crate) with_ssim: bool,
    pub(crate) with_exposure: bool,
    /// Steps in flight.
    pub(crate) steps: usize,
}

impl Target {
    /// Allocates all buffers. `failed`: what the counters begin with.
    ///
    /// # Errors
    /// `OutOfMemory`, `Limit`.
    pub(crate) fn new(gpu: &Gpu, size: TargetSize, failed: &Buffer) -> Result<Self> {
        let [width, height] = size.image;
        if width == 0 || height == 0 {
            return Err(Error::usage("training image", format!("{width}×{height}"), "at least 1×1 pixels"));
        }
        let tiles = tiles_of([width, height]);
        let pixels = u64::from(width) * u64::from(height);
        let device = |name: &str, bytes: u64| gpu.buffer(name, bytes, Memory::Device);
        let slots = size.with_slots.then(|| SlotBuffers::new(gpu, size.gaussians, size.capacity)).transpose()?;
        let color = device("color", pixels * 16)?;
        let counters = gpu.buffer("counters readback", 32, Memory::Readback)?;
        let frame = || {
            let frame = gpu.buffer("frame", size_of::<Frame>() as u64, Memory::Constants)?;
            let (color, counters) = (color.clone(), counters.clone());
            Ok(FrameBuffers { frame, host_pose: None, color, depth: None, counters })
        };
        let row_bytes = u64::from(size.capacity.max(1)) * u64::from(ROW_WORDS) * 4;
        Ok(Self {
            size: size.image,
            capacity: size.capacity,
            work: WorkBuffers::new(gpu, size.gaussians, tiles, size.capacity)?,
            frames: (0..size.steps).map(|_| frame()).collect::<Result<_>>()?,
            instance_gradient: slots.as_ref().map(|_| device("instance_gradient", row_bytes)).transpose()?,
            shape: Shape {
                tiles,
                slots,
                states: States::of_device(gpu, size.image)?,
                first_counters: Some(failed.clone()),
                ..Shape::default()
            },
            image_gradient: device("image_gradient", pixels * 16)?,
            loss: device("loss", LOSS_WORDS as u64 * 4)?,
            image_loss: LossPass::new(gpu, width, height, size.with_ssim)?,
            exposure: size.with_exposure.then(|| ExposurePass::new(gpu, size.image)).transpose()?,
            commands: (0..size.steps).map(|_| None).collect(),
        })
    }

    /// Recordings that no longer hold what they use.
    pub(crate) fn forget_commands(&mut self) {
        self.commands.iter_mut().for_each(|commands| *commands = None);
    }

    /// A recording of the step.
    pub(crate) fn recorded(&self) -> Option<&Commands> {
        self.commands.iter().flatten().map(|(_, commands)| commands).next()
    }
}

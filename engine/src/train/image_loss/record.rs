//! Recording of the image loss.

use super::image_loss_sum::{IMAGE_LOSS_SUM, ImageLossSumBuffers, ImageLossSumConstants};
use super::ssim_forward::{SSIM_FORWARD, SsimForwardBuffers, SsimForwardConstants};
use super::{IMAGE_LOSS, ImageLossBuffers, ImageLossConstants, LossStage, TargetFormat, map_words};
use crate::error::Result;
use crate::gpu::{Buffer, Gpu, Groups, Memory, Recorder};

/// Buffers of the loss that belong to others.
#[derive(Debug, Clone, Copy)]
pub struct LossPassBuffers<'a> {
    /// [`crate::render::frame::Frame`]: size and background.
    pub frame: &'a Buffer,
    /// [`crate::train::step::Step`]: λ, and where the target begins.
    pub step: &'a Buffer,
    /// `vec4[H·W]` rendered image.
    pub color: &'a Buffer,
    /// Target image, as [`TargetFormat`] says.
    pub target: &'a Buffer,
    /// `vec4[H·W]` result: gradient by the channels, w = 0.
    pub image_gradient: &'a Buffer,
    /// `float[LOSS_WORDS]`: see [`super::image_loss_sum`].
    pub loss: &'a Buffer,
    /// Reports of numbers that are not finite.
    pub status: &'a Buffer,
}

/// Recording of the loss for one image size, with its scratch.
#[derive(Debug)]
pub struct LossPass {
    stage: LossStage,
    groups: u32,
    /// [`map_words`]; none without SSIM.
    ssim_maps: Option<Buffer>,
    /// float[3 sums][workgroups].
    loss_partial: Buffer,
}

impl LossPass {
    /// Scratch for images of this size, px. `with_ssim` false skips all work of SSIM (for λ = 0): λ is then taken as 0.
    pub fn new(gpu: &Gpu, width: u32, height: u32, with_ssim: bool) -> Result<Self> {
        let maps = || gpu.buffer("ssim_maps", 4 * map_words(width, height), Memory::Device);
        let stage = LossStage::of(gpu);
        let groups = stage.groups(width, height);
        Ok(Self {
            stage,
            groups,
            ssim_maps: with_ssim.then(maps).transpose()?,
            loss_partial: gpu.buffer("loss_partial", 12 * u64::from(groups), Memory::Device)?,
        })
    }

    /// Records the loss and its gradient.
    pub fn record(&self, r: &mut Recorder, b: &LossPassBuffers<'_>, target: TargetFormat) -> Result<()> {
        let (target, with_ssim, stage) = (target as u32, u32::from(self.ssim_maps.is_some()), self.stage as u32);
        let grid = Groups::Direct(self.groups.into());
        if let Some(ssim_maps) = &self.ssim_maps {
            let buffers = SsimForwardBuffers {
                frame: b.frame.whole(),
                color: b.color.whole(),
                target: b.target.whole(),
                ssim_maps: ssim_maps.whole(),
                loss_partial: self.loss_partial.whole(),
                step: b.step.whole(),
            };
            r.dispatch(&SSIM_FORWARD, SsimForwardConstants { target, stage }, (), buffers, grid.clone())?;
        }
        let buffers = ImageLossBuffers {
            frame: b.frame.whole(),
            step: b.step.whole(),
            color: b.color.whole(),
            target: b.target.whole(),
            ssim_maps: self.ssim_maps.as_ref().map(Buffer::whole),
            image_gradient: b.image_gradient.whole(),
            loss_partial: self.loss_partial.whole(),
            status: b.status.whole(),
        };
        r.dispatch(&IMAGE_LOSS, ImageLossConstants { target, with_ssim, stage }, (), buffers, grid)?;
        let buffers = ImageLossSumBuffers {
            frame: b.frame.whole(),
            step: b.step.whole(),
            loss_partial: self.loss_partial.whole(),
            loss: b.loss.whole(),
        };
        r.dispatch(&IMAGE_LOSS_SUM, ImageLossSumConstants { with_ssim, stage }, (), buffers, Groups::Direct(1))
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.ssim_maps.as_ref().map_or(0, Buffer::bytes) + self.loss_partial.bytes()
    }
}

//! Image loss L = (1 − λ)·L1 + λ·(1 − SSIM) and its gradient by the rendered image (Kerbl et al. 2023, eq. 7; SSIM of Wang
//! et al. 2004).
//!
//! L1 and SSIM are means over H·W·3 values. SSIM has an 11×11 Gaussian window of σ = 1.5 px, zeros outside the image,
//! C1 = 0.01², C2 = 0.03². The rendered image is not clamped. Three kernels: [`SSIM_FORWARD`] computes local moments and
//! the derivatives of SSIM by them, [`IMAGE_LOSS`] convolves those back and adds the sign of L1, [`IMAGE_LOSS_SUM`] adds
//! up the workgroups' sums in a fixed order. Without SSIM (λ = 0) the first is skipped.
//!
//! A rendered value that is not finite (or beyond ±[`MAX_COLOR`]) takes no part: its gradient is 0, it is reported to
//! `status`, and its neighbours see the target's value in its place.

mod gradient;
mod pixels;
mod ssim_forward;
mod sum;

pub use gradient::IMAGE_LOSS;
pub use pixels::{MAX_COLOR, SSIM_C1, SSIM_C2, WINDOW};
pub use ssim_forward::SSIM_FORWARD;
pub use sum::IMAGE_LOSS_SUM;

use crate::error::Result;
use crate::gpu::kernel::Kernel;
use crate::gpu::{Buffer, Gpu, Groups, Memory, Recorder, Slice};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&SSIM_FORWARD, &IMAGE_LOSS, &IMAGE_LOSS_SUM];

/// Width and height of a workgroup's tile, px.
pub const LOSS_TILE: [u32; 2] = [32, 48];
/// Words of the `loss` buffer: L, L1, SSIM (0 when it was skipped), MSE, then zeros.
pub const LOSS_WORDS: usize = 8;

/// How the target image is stored (spec constant `TARGET`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum TargetFormat {
    /// uint per pixel: premultiplied RGBA, 8 bits each, r lowest; the value is rgb/255 + (1 − a/255)·background.
    Rgba8 = 0,
    /// Four words per pixel: the bits of the floats r, g, b and one unused.
    Float = 1,
}

/// Workgroups of `ssim_forward` and `image_loss`: three channels per tile.
pub fn groups(width: u32, height: u32) -> u32 {
    3 * width.div_ceil(LOSS_TILE[0]) * height.div_ceil(LOSS_TILE[1])
}

/// Buffers that a recording of the loss binds.
#[derive(Debug, Clone, Copy)]
pub struct ImageLossBuffers<'a> {
    /// [`crate::render::frame::Frame`]: size and background.
    pub frame: &'a Buffer,
    /// [`crate::train::step::Step`]: λ.
    pub step: &'a Buffer,
    /// `vec4[H·W]` rendered image.
    pub color: &'a Buffer,
    /// Target image, as [`TargetFormat`] says.
    pub target: &'a Buffer,
    /// `vec4[H·W]` result: gradient by the channels, w = 0.
    pub image_gradient: &'a Buffer,
    /// float[[`LOSS_WORDS`]] result.
    pub loss: &'a Buffer,
    /// Reports of numbers that are not finite.
    pub status: &'a Buffer,
}

/// Scratch of the loss for one image size.
#[derive(Debug)]
pub struct ImageLoss {
    width: u32,
    height: u32,
    with_ssim: bool,
    /// float[3 channels][3 derivatives][H·W], or a dummy without SSIM.
    ssim_maps: Buffer,
    /// float[3 sums][workgroups].
    loss_partial: Buffer,
}

impl ImageLoss {
    /// Scratch for images of this size, px. `with_ssim` false skips all work of SSIM (for λ = 0): λ is then taken as 0.
    pub fn new(gpu: &Gpu, width: u32, height: u32, with_ssim: bool) -> Result<Self> {
        let pixels = if with_ssim { u64::from(width) * u64::from(height) } else { 1 };
        Ok(Self {
            width,
            height,
            with_ssim,
            ssim_maps: gpu.buffer("ssim_maps", 36 * pixels, Memory::Device)?,
            loss_partial: gpu.buffer("loss_partial", 12 * u64::from(groups(width, height)), Memory::Device)?,
        })
    }

    /// Records the loss and its gradient.
    pub fn record(&self, r: &mut Recorder, b: &ImageLossBuffers<'_>, target: TargetFormat) -> Result<()> {
        let (format, with_ssim) = (target as u32, u32::from(self.with_ssim));
        let grid = Groups::Direct(groups(self.width, self.height).into());
        let slices = |list: &[&Buffer]| list.iter().map(|b| Slice::from(*b)).collect::<Vec<_>>();
        if self.with_ssim {
            let buffers = slices(&[b.frame, b.color, b.target, &self.ssim_maps, &self.loss_partial]);
            r.dispatch_untyped(&SSIM_FORWARD, &[format], &[], &buffers, grid.clone())?;
        }
        let buffers = slices(&[
            b.frame,
            b.step,
            b.color,
            b.target,
            &self.ssim_maps,
            b.image_gradient,
            &self.loss_partial,
            b.status,
        ]);
        r.dispatch_untyped(&IMAGE_LOSS, &[format, with_ssim], &[], &buffers, grid)?;
        let buffers = slices(&[b.frame, b.step, &self.loss_partial, b.loss]);
        r.dispatch_untyped(&IMAGE_LOSS_SUM, &[with_ssim], &[], &buffers, Groups::Direct(1))
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.ssim_maps.bytes() + self.loss_partial.bytes()
    }
}

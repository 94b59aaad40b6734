//! Kernel `image_loss`, and its family: image loss L = (1 − λ)·L1 + λ·(1 − SSIM) and its gradient by the rendered image (Kerbl et al. 2023, eq. 7; SSIM of Wang
//! et al. 2004).
//!
//! L1 and SSIM are means over H·W·3 values. SSIM has an 11×11 Gaussian window of σ = 1.5 px, zeros outside the image,
//! C1 = 0.01², C2 = 0.03². The rendered image is not clamped. Three kernels: [`ssim_forward`] computes local moments and
//! the derivatives of SSIM by them, [`IMAGE_LOSS`] convolves those back and adds the sign of L1, [`image_loss_sum`] adds
//! up the workgroups' sums in a fixed order. Without SSIM (λ = 0) the first is skipped.
//!
//! A rendered value that is not finite (or beyond ±[`MAX_COLOR`]) takes no part: its gradient is 0, it is reported to
//! `status`, and its neighbours see the target's value in its place. Nor does a pixel that a mask leaves out
//! ([`LEFT_OUT`](crate::data::pixels::LEFT_OUT) in the target): there the target is what was rendered. Means count it as equal.

pub mod image_loss_sum;
mod pixels;
mod record;
pub mod ssim_forward;

pub use pixels::{MAX_COLOR, SSIM_C1, SSIM_C2, WINDOW};
pub use record::{LossPass, LossPassBuffers};

use self::pixels::{convolve, image_and_target, is_left_out, map_at, sums_of_groups, target_value, usable};
use crate::gpu::Gpu;
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Kernel, Tolerance};
use crate::render::frame::Frame;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::status;
use crate::train::step::Step;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] =
    &[&ssim_forward::SSIM_FORWARD.kernel, &IMAGE_LOSS.kernel, &image_loss_sum::IMAGE_LOSS_SUM.kernel];

/// Threads of a workgroup.
const LOSS_THREADS: u32 = 128;
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
    /// As `Rgba8`; a pixel that is [`LEFT_OUT`](crate::data::pixels::LEFT_OUT) takes no part.
    MaskedRgba8 = 2,
}

impl TargetFormat {
    /// Of photos, of which some have masks that training looks at, or none.
    pub(in crate::train) fn of_photos(masked: bool) -> Self {
        if masked { Self::MaskedRgba8 } else { Self::Rgba8 }
    }
}

/// How the pixels of an image reach the threads of `ssim_forward` and `image_loss` (spec constant `STAGE`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum LossStage {
    /// A strip of 16×48 pixels per thread, straight from memory: for CPU devices.
    Strip = 0,
    /// A tile of 32×48 pixels per workgroup, through shared memory: for GPUs.
    Shared = 1,
}

impl LossStage {
    /// The better one for this device.
    pub fn of(gpu: &Gpu) -> Self {
        if gpu.info().is_cpu() { Self::Strip } else { Self::Shared }
    }

    /// Workgroups of `ssim_forward` and `image_loss`, of which every third works on the same channel.
    pub fn groups(self, width: u32, height: u32) -> u32 {
        let [wide, high] = self.strip();
        let strips = width.div_ceil(wide) * height.div_ceil(high);
        3 * match self {
            Self::Strip => strips.div_ceil(LOSS_THREADS),
            Self::Shared => strips,
        }
    }

    /// Width and height of what a thread or, in shared memory, a workgroup owns; px.
    const fn strip(self) -> [u32; 2] {
        match self {
            Self::Strip => [16, 48],
            Self::Shared => [32, 48],
        }
    }

    /// The workgroup of a pixel of a channel.
    fn group_of(self, channel: u32, pixel: [u32; 2], width: u32) -> u32 {
        let [wide, high] = self.strip();
        let strip = pixel[1] / high * width.div_ceil(wide) + pixel[0] / wide;
        3 * match self {
            Self::Strip => strip / LOSS_THREADS,
            Self::Shared => strip,
        } + channel
    }

    fn of_constant(value: u32) -> Self {
        if value == 0 { Self::Strip } else { Self::Shared }
    }
}

/// Words of the derivatives of SSIM: `float[3 channels][3][H][W to a multiple of 4]`.
pub fn map_words(width: u32, height: u32) -> u64 {
    9 * u64::from(width.next_multiple_of(4)) * u64::from(height)
}

crate::gpu_constants! {
    /// Specialisation constants of [`IMAGE_LOSS`].
    pub struct ImageLossConstants {
        /// A [`TargetFormat`].
        target,
        /// 0: λ is taken as 0.
        with_ssim,
        /// A [`LossStage`].
        stage,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`IMAGE_LOSS`].
    pub struct ImageLossBuffers {
        /// Size and background.
        frame: Read Struct(Frame),
        /// λ; where the target begins.
        step: Read Struct(Step),
        /// `vec4[H·W]` rendered image.
        color: Read F32,
        /// Target image, as [`TargetFormat`] says, from the step's word on.
        target: Read U32,
        /// [`map_words`] of [`ssim_forward`]; absent without SSIM.
        ssim_maps: optional Read F32,
        /// `vec4[H·W]`, w = 0.
        image_gradient: Write F32,
        /// `float[3][workgroups]`: sums of |x − y| in plane 1 and of (x − y)² in plane 2.
        loss_partial: Write F32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// Gradient by the rendered image. Dispatch [`LossStage::groups`] workgroups.
    pub static IMAGE_LOSS: ImageLoss = {
        name: "image_loss",
        doc: "gradient of (1 - lambda) L1 + lambda (1 - SSIM) by the rendered image, sums of L1 and MSE",
        local_size: LOSS_THREADS,
        constants: ImageLossConstants,
        push: (),
        buffers: ImageLossBuffers,
        twin: image_loss_twin,
        tolerance: Tolerance { absolute: 1e-7, relative: 1e-4, flips: 0.0 },
        bytes: |w| 72 * w.get("pixels"),
    }
}

fn image_loss_twin(call: Call<'_, ImageLoss>) {
    let Call { constants, buffers: b, .. } = call;
    let (kind, with_ssim) = (constants.target, constants.with_ssim == 1);
    let frame: Frame = struct_at(b.frame, 0);
    let step: Step = struct_at(b.step, 0);
    let target = &b.target[step.photo as usize..];
    let [width, height] = frame.size;
    let pixels = (width * height) as usize;
    let stage = LossStage::of_constant(constants.stage);
    let groups = stage.groups(width, height);
    let lambda = if with_ssim { step.weight_dssim } else { 0.0 };
    let per_value = 1.0 / (3.0 * pixels as f32);
    for channel in 0..3 {
        let by_moment: Vec<[f32; 3]> = if let (true, Some(ssim_maps)) = (with_ssim, &b.ssim_maps) {
            let at = |map: usize, i: usize| f32_at(ssim_maps, map_at(&frame, 3 * channel + map, i));
            let maps: Vec<[f32; 3]> = (0..pixels).map(|i| [at(0, i), at(1, i), at(2, i)]).collect();
            convolve(&maps, width as usize, height as usize)
        } else {
            vec![[0.0; 3]; pixels]
        };
        for i in 0..pixels {
            let [x, y] = image_and_target(&frame, [b.color, target], kind, i, channel);
            let d = x - y;
            let m = by_moment[i];
            let by_ssim = m[0] + 2.0 * x * m[1] + 2.0 * d * m[2];
            let sign = if d == 0.0 { 0.0 } else { d.signum() };
            let left_out = is_left_out(target, kind, i);
            let gradient = if left_out { 0.0 } else { per_value * ((1.0 - lambda) * sign - lambda * by_ssim) };
            let good = usable(f32_at(b.color, 4 * i + channel))
                && usable(target_value(&frame, target, kind, i, channel))
                && gradient.is_finite();
            if !good {
                status::report(b.status, status::IMAGE_GRADIENT, i as u32);
            }
            set_f32(b.image_gradient, 4 * i + channel, if good { gradient } else { 0.0 });
            set_f32(b.image_gradient, 4 * i + 3, 0.0);
        }
        let difference = |i: usize| {
            let [x, y] = image_and_target(&frame, [b.color, target], kind, i, channel);
            x - y
        };
        let of_difference: [fn(f32) -> f32; 2] = [f32::abs, |d| d * d];
        for (plane, value) in (1..).zip(of_difference) {
            for (group, sum) in sums_of_groups(&frame, stage, channel as u32, |i| value(difference(i))) {
                set_f32(b.loss_partial, plane * groups as usize + group, sum);
            }
        }
    }
}

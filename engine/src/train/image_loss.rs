//! Kernel `image_loss`, and its family: image loss L = (1 − λ)·L1 + λ·(1 − SSIM) and its gradient by the rendered image (Kerbl et al. 2023, eq. 7; SSIM of Wang
//! et al. 2004).
//!
//! L1 and SSIM are means over H·W·3 values. SSIM has an 11×11 Gaussian window of σ = 1.5 px, zeros outside the image,
//! C1 = 0.01², C2 = 0.03². The rendered image is not clamped. Three kernels: [`ssim_forward`] computes local moments and
//! the derivatives of SSIM by them, [`IMAGE_LOSS`] convolves those back and adds the sign of L1, [`image_loss_sum`] adds
//! up the workgroups' sums in a fixed order. Without SSIM (λ = 0) the first is skipped.
//!
//! A rendered value that is not finite (or beyond ±[`MAX_COLOR`]) takes no part: its gradient is 0, it is reported to
//! `status`, and its neighbours see the target's value in its place.

pub mod image_loss_sum;
mod pixels;
mod record;
pub mod ssim_forward;

pub use pixels::{MAX_COLOR, SSIM_C1, SSIM_C2, WINDOW};
pub use record::{LossPass, LossPassBuffers};

use self::pixels::{convolve, image_and_target, sum_of_tile, target_value, usable};
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Kernel, Tolerance};
use crate::render::frame::Frame;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::status;
use crate::train::step::Step;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] =
    &[&ssim_forward::SSIM_FORWARD.kernel, &IMAGE_LOSS.kernel, &image_loss_sum::IMAGE_LOSS_SUM.kernel];

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

crate::gpu_constants! {
    /// Specialisation constants of [`IMAGE_LOSS`].
    pub struct ImageLossConstants {
        /// A [`TargetFormat`].
        target,
        /// 0: λ is taken as 0.
        with_ssim,
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
        /// `float[3 channels][3][H·W]` of [`ssim_forward`]; absent without SSIM.
        ssim_maps: optional Read F32,
        /// `vec4[H·W]`, w = 0.
        image_gradient: Write F32,
        /// `float[3][workgroups]`: sums of |x − y| in plane 1 and of (x − y)² in plane 2.
        loss_partial: Write F32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// Gradient by the rendered image. Dispatch [`groups`] workgroups.
    pub static IMAGE_LOSS: ImageLoss = {
        name: "image_loss",
        doc: "gradient of (1 - lambda) L1 + lambda (1 - SSIM) by the rendered image, sums of L1 and MSE",
        local_size: 128,
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
    let groups = groups(width, height);
    let lambda = if with_ssim { step.weight_dssim } else { 0.0 };
    let per_value = 1.0 / (3.0 * pixels as f32);
    for channel in 0..3 {
        let by_moment: Vec<[f32; 3]> = if let (true, Some(ssim_maps)) = (with_ssim, &b.ssim_maps) {
            let at = |plane: usize, i: usize| f32_at(ssim_maps, (3 * channel + plane) * pixels + i);
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
            let gradient = per_value * ((1.0 - lambda) * sign - lambda * by_ssim);
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
        for group in (channel as u32..groups).step_by(3) {
            let sums = [
                sum_of_tile(&frame, group / 3, |i| difference(i).abs()),
                sum_of_tile(&frame, group / 3, |i| difference(i) * difference(i)),
            ];
            set_f32(b.loss_partial, (groups + group) as usize, sums[0]);
            set_f32(b.loss_partial, (2 * groups + group) as usize, sums[1]);
        }
    }
}

//! Kernel `image_loss_sum`: the loss from the sums of the workgroups.

use super::LossStage;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::frame::Frame;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::step::Step;

crate::gpu_constants! {
    /// Specialisation constants of [`IMAGE_LOSS_SUM`].
    pub struct ImageLossSumConstants {
        /// 0: λ is taken as 0, and SSIM is 0.
        with_ssim,
        /// A [`LossStage`], that of the kernels before.
        stage,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`IMAGE_LOSS_SUM`].
    pub struct ImageLossSumBuffers {
        /// Size.
        frame: Read Struct(Frame),
        /// λ.
        step: Read Struct(Step),
        /// `float[3][workgroups]`: sums of SSIM, |x − y| and (x − y)².
        loss_partial: Read F32,
        /// `float[8]` = (L, L1, SSIM, MSE, 0, 0, 0, 0).
        loss: Write F32,
    }
}

crate::kernel! {
    /// Adds up `loss_partial` in a fixed order. Dispatch 1 workgroup.
    pub static IMAGE_LOSS_SUM: ImageLossSum = {
        name: "image_loss_sum",
        doc: "image loss, L1, SSIM and MSE from the sums of the workgroups",
        local_size: 256,
        constants: ImageLossSumConstants,
        push: (),
        buffers: ImageLossSumBuffers,
        twin: image_loss_sum_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-5, flips: 0.0 },
        bytes: |w| 12 * w.get("pixels") / 1024,
    }
}

fn image_loss_sum_twin(call: Call<'_, ImageLossSum>) {
    let Call { constants, buffers: b, .. } = call;
    let with_ssim = constants.with_ssim == 1;
    let frame: Frame = struct_at(b.frame, 0);
    let step: Step = struct_at(b.step, 0);
    let groups = LossStage::of_constant(constants.stage).groups(frame.size[0], frame.size[1]) as usize;
    let values = 3.0 * f64::from(frame.size[0]) * f64::from(frame.size[1]);
    let mean = |plane: usize| {
        let sum: f64 = (0..groups).map(|g| f64::from(f32_at(b.loss_partial, plane * groups + g))).sum();
        (sum / values) as f32
    };
    let ssim = if with_ssim { mean(0) } else { 0.0 };
    let lambda = if with_ssim { step.weight_dssim } else { 0.0 };
    b.loss[..8].fill(0);
    set_f32(b.loss, 0, (1.0 - lambda) * mean(1) + lambda * (1.0 - ssim));
    set_f32(b.loss, 1, mean(1));
    set_f32(b.loss, 2, ssim);
    set_f32(b.loss, 3, mean(2));
}

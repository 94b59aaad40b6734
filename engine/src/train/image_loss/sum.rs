//! Kernel `image_loss_sum`: the loss from the sums of the workgroups.

use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::frame::Frame;
use crate::render::twin::{self, f32_at, set_f32, struct_at};
use crate::train::step::Step;

/// Adds up `loss_partial` in a fixed order. Dispatch 1 workgroup. `loss` `float[8]` = (L, L1, SSIM, MSE, 0, 0, 0, 0); SSIM is 0
/// when `WITH_SSIM` is 0.
pub static IMAGE_LOSS_SUM: Kernel = Kernel {
    name: "image_loss_sum",
    doc: "image loss, L1, SSIM and MSE from the sums of the workgroups",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "WITH_SSIM"],
    push: &[],
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("loss_partial", Access::Read, Element::F32),
        Binding::new("loss", Access::Write, Element::F32),
    ],
    twin: image_loss_sum_twin,
    tolerance: Tolerance { absolute: 1e-6, relative: 1e-5, flips: 0.0 },
    bytes: |w| 12 * w.get("pixels") / 1024,
    spirv: include_bytes!("../../../../spirv_cache/image_loss_sum.spv"),
};

fn image_loss_sum_twin(call: &mut TwinCall<'_>) {
    let with_ssim = twin::spec(call, 1) == 1;
    let [frame, step, loss_partial, loss] = call.buffers else { return };
    let frame: Frame = struct_at(frame, 0);
    let step: Step = struct_at(step, 0);
    let groups = super::groups(frame.size[0], frame.size[1]) as usize;
    let values = 3.0 * f64::from(frame.size[0]) * f64::from(frame.size[1]);
    let mean = |plane: usize| {
        let sum: f64 = (0..groups).map(|g| f64::from(f32_at(loss_partial, plane * groups + g))).sum();
        (sum / values) as f32
    };
    let ssim = if with_ssim { mean(0) } else { 0.0 };
    let lambda = if with_ssim { step.weight_dssim } else { 0.0 };
    loss[..8].fill(0);
    set_f32(loss, 0, (1.0 - lambda) * mean(1) + lambda * (1.0 - ssim));
    set_f32(loss, 1, mean(1));
    set_f32(loss, 2, ssim);
    set_f32(loss, 3, mean(2));
}

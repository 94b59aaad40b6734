//! Kernel `image_loss`: the gradient of the loss by the rendered image, and the sums of L1 and MSE.

use super::pixels::{convolve, image_and_target, sum_of_tile, target_value, usable};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::frame::Frame;
use crate::render::twin::{self, f32_at, set_f32, struct_at};
use crate::train::status;
use crate::train::step::Step;

/// Place of `image_gradient` in [`status::GROUPS`].
const STATUS_IMAGE_GRADIENT: usize = 8;

/// Gradient by the rendered image. Dispatch [`super::groups`] workgroups. `image_gradient` `vec4[H·W]`, w = 0; `loss_partial`
/// gets the sums of |x − y| in plane 1 and of (x − y)² in plane 2. With `WITH_SSIM` = 0 λ is taken as 0 and `ssim_maps` may
/// be a dummy.
pub static IMAGE_LOSS: Kernel = Kernel {
    name: "image_loss",
    doc: "gradient of (1 - lambda) L1 + lambda (1 - SSIM) by the rendered image, sums of L1 and MSE",
    local_size: 128,
    spec: &["SUBGROUP_SIZE", "TARGET", "WITH_SSIM"],
    push: &[],
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("color", Access::Read, Element::F32),
        Binding::new("target", Access::Read, Element::U32),
        Binding::new("ssim_maps", Access::Read, Element::F32),
        Binding::new("image_gradient", Access::Write, Element::F32),
        Binding::new("loss_partial", Access::Write, Element::F32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: image_loss_twin,
    tolerance: Tolerance { absolute: 1e-7, relative: 1e-4, flips: 0.0 },
    bytes: |w| 72 * w.get("pixels"),
    spirv: include_bytes!("../../../../spirv_cache/image_loss.spv"),
};

fn image_loss_twin(call: &mut TwinCall<'_>) {
    let (kind, with_ssim) = (twin::spec(call, 1), twin::spec(call, 2) == 1);
    let [frame, step, color, target, ssim_maps, image_gradient, loss_partial, status_words] = call.buffers else {
        return;
    };
    let frame: Frame = struct_at(frame, 0);
    let step: Step = struct_at(step, 0);
    let [width, height] = frame.size;
    let pixels = (width * height) as usize;
    let groups = super::groups(width, height);
    let lambda = if with_ssim { step.weight_dssim } else { 0.0 };
    let per_value = 1.0 / (3.0 * pixels as f32);
    for channel in 0..3 {
        let by_moment: Vec<[f32; 3]> = if with_ssim {
            let at = |plane: usize, i: usize| f32_at(ssim_maps, (3 * channel + plane) * pixels + i);
            let maps: Vec<[f32; 3]> = (0..pixels).map(|i| [at(0, i), at(1, i), at(2, i)]).collect();
            convolve(&maps, width as usize, height as usize)
        } else {
            vec![[0.0; 3]; pixels]
        };
        for i in 0..pixels {
            let [x, y] = image_and_target(&frame, [color, target], kind, i, channel);
            let d = x - y;
            let m = by_moment[i];
            let by_ssim = m[0] + 2.0 * x * m[1] + 2.0 * d * m[2];
            let sign = if d == 0.0 { 0.0 } else { d.signum() };
            let gradient = per_value * ((1.0 - lambda) * sign - lambda * by_ssim);
            let good = usable(f32_at(color, 4 * i + channel))
                && usable(target_value(&frame, target, kind, i, channel))
                && gradient.is_finite();
            if !good {
                status::report(status_words, STATUS_IMAGE_GRADIENT, i as u32);
            }
            set_f32(image_gradient, 4 * i + channel, if good { gradient } else { 0.0 });
            set_f32(image_gradient, 4 * i + 3, 0.0);
        }
        let difference = |i: usize| {
            let [x, y] = image_and_target(&frame, [color, target], kind, i, channel);
            x - y
        };
        for group in (channel as u32..groups).step_by(3) {
            let sums = [
                sum_of_tile(&frame, group / 3, |i| difference(i).abs()),
                sum_of_tile(&frame, group / 3, |i| difference(i) * difference(i)),
            ];
            set_f32(loss_partial, (groups + group) as usize, sums[0]);
            set_f32(loss_partial, (2 * groups + group) as usize, sums[1]);
        }
    }
}

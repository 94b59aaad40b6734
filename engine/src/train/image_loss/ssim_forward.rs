//! Kernel `ssim_forward`: SSIM and its derivatives by the local moments.

use super::pixels::{SSIM_C1, SSIM_C2, convolve, image_and_target, sum_of_tile};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::frame::Frame;
use crate::render::twin::{set_f32, struct_at};
use crate::train::step::Step;

crate::gpu_constants! {
    /// Specialisation constants of [`SSIM_FORWARD`].
    pub struct SsimForwardConstants {
        /// A [`super::TargetFormat`].
        target,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SSIM_FORWARD`].
    pub struct SsimForwardBuffers {
        /// Size and background.
        frame: Read Struct(Frame),
        /// `vec4[H·W]` rendered image.
        color: Read F32,
        /// Target image, as [`super::TargetFormat`] says, from the step's word on.
        target: Read U32,
        /// `float[3 channels][3][H·W]`: dSSIM/dμ_x, dSSIM/dE[x² + y²] and dSSIM/dE[(x − y)²] of each pixel.
        ssim_maps: Write F32,
        /// `float[3][workgroups]`: sums of SSIM in plane 0.
        loss_partial: Write F32,
        /// Where the target begins.
        step: Read Struct(Step),
    }
}

crate::kernel! {
    /// Local moments, SSIM, and its derivatives. Dispatch [`super::groups`] workgroups.
    pub static SSIM_FORWARD: SsimForward = {
        name: "ssim_forward",
        doc: "local moments of rendered and target image, SSIM and its derivatives by the moments",
        local_size: 128,
        constants: SsimForwardConstants,
        push: (),
        buffers: SsimForwardBuffers,
        twin: ssim_forward_twin,
        // Variances are differences of moments: relative to C2 they lose four digits. Derivatives reach 1/C2 = 1111, and that by
        // the sum of variances is var_d/b_2²: where images are flat and apart, rounding of E[d²] (6e-8·d², a few times) is
        // divided by C2² = 8e-7. With d² = 0.1 and another order of sums this is 0.02.
        tolerance: Tolerance { absolute: 2e-2, relative: 2e-3, flips: 0.0 },
        bytes: |w| 56 * w.get("pixels"),
    }
}

/// SSIM from the moments (x, d, d², x² + y²), and its derivatives by μ_x, E[x² + y²] and E[d²].
fn ssim_and_derivatives([mu_x, mu_d, mean_d2, mean_x2_y2]: [f32; 4]) -> [f32; 4] {
    let mu_y = mu_x - mu_d;
    let b_1 = mu_x * mu_x + mu_y * mu_y + SSIM_C1;
    let b_2 = (mean_x2_y2 - mu_x * mu_x - mu_y * mu_y).max(0.0) + SSIM_C2;
    let var_d = (mean_d2 - mu_d * mu_d).max(0.0);
    let (r_1, r_2) = (mu_d / b_1, var_d / b_2);
    let (l, c) = (1.0 - mu_d * r_1, 1.0 - r_2);
    let by_sum = l * r_2 / b_2;
    let by_difference = -l / b_2;
    let by_mean = 2.0 * (r_1 * (r_1 * mu_x - 1.0) * c - by_difference * mu_d - by_sum * mu_x);
    [l * c, by_mean, by_sum, by_difference]
}

fn ssim_forward_twin(call: Call<'_, SsimForward>) {
    let Call { constants: SsimForwardConstants { target: kind }, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let target = &b.target[struct_at::<Step>(b.step, 0).photo as usize..];
    let [width, height] = frame.size;
    let pixels = (width * height) as usize;
    let groups = super::groups(width, height);
    for channel in 0..3 {
        let moments: Vec<[f32; 4]> = (0..pixels)
            .map(|i| {
                let [x, y] = image_and_target(&frame, [b.color, target], kind, i, channel);
                let d = x - y;
                [x, d, d * d, x * x + y * y]
            })
            .collect();
        let moments = convolve(&moments, width as usize, height as usize);
        for group in (channel as u32..groups).step_by(3) {
            let sum = sum_of_tile(&frame, group / 3, |i| {
                let [ssim, derivatives @ ..] = ssim_and_derivatives(moments[i]);
                for (plane, value) in derivatives.into_iter().enumerate() {
                    set_f32(b.ssim_maps, (3 * channel + plane) * pixels + i, value);
                }
                ssim
            });
            set_f32(b.loss_partial, group as usize, sum);
        }
    }
}

//! Kernel `ssim_forward`: SSIM and its derivatives by the local moments.

use super::pixels::{SSIM_C1, SSIM_C2, convolve, image_and_target, map_at, sums_of_groups};
use super::{LOSS_THREADS, LossStage};
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
        /// A [`LossStage`].
        stage,
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
        /// `float[3 channels][3][H][W to a multiple of 4]` ([`super::map_words`]): dSSIM/dμ_x, dSSIM/dE[x² + y²] and
        /// dSSIM/dE[(x − y)²] of each pixel, and zeros.
        ssim_maps: Write F32,
        /// `float[3][workgroups]`: sums of SSIM in plane 0.
        loss_partial: Write F32,
        /// Where the target begins.
        step: Read Struct(Step),
    }
}

crate::kernel! {
    /// Local moments, SSIM, and its derivatives. Dispatch [`LossStage::groups`] workgroups.
    pub static SSIM_FORWARD: SsimForward = {
        name: "ssim_forward",
        doc: "local moments of rendered and target image, SSIM and its derivatives by the moments",
        local_size: LOSS_THREADS,
        constants: SsimForwardConstants,
        push: (),
        buffers: SsimForwardBuffers,
        twin: ssim_forward_twin,
        // Variances are differences of moments: relative to C2 they lose four digits, and derivatives reach 1/C2 = 1111. That by
        // the sum of variances is var_d/b_2²: where images are flat and apart, rounding of E[d²] is divided by C2² = 8e-7. With
        // d² = 0.1 the twin itself is 0.035 off (test below). An ulp of d² = 1 is 0.074 so, and twice that by the mean; an
        // H200 was 0.047 off in one value of 9,720 of its self-test.
        tolerance: Tolerance { absolute: 1.5e-1, relative: 2e-3, flips: 0.0 },
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
    let Call { constants: SsimForwardConstants { target: kind, stage }, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let target = &b.target[struct_at::<Step>(b.step, 0).photo as usize..];
    let [width, height] = frame.size;
    let pixels = (width * height) as usize;
    let stage = LossStage::of_constant(stage);
    b.ssim_maps.fill(0);
    for channel in 0..3 {
        let moments: Vec<[f32; 4]> = (0..pixels)
            .map(|i| {
                let [x, y] = image_and_target(&frame, [b.color, target], kind, i, channel);
                let d = x - y;
                [x, d, d * d, x * x + y * y]
            })
            .collect();
        let moments = convolve(&moments, width as usize, height as usize);
        let sums = sums_of_groups(&frame, stage, channel as u32, |i| {
            let [ssim, derivatives @ ..] = ssim_and_derivatives(moments[i]);
            for (map, value) in derivatives.into_iter().enumerate() {
                set_f32(b.ssim_maps, map_at(&frame, 3 * channel + map, i), value);
            }
            ssim
        });
        for (group, sum) in sums {
            set_f32(b.loss_partial, group, sum);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::pixels::WINDOW;
    use super::*;

    const SIDE: usize = 24;

    /// SSIM's derivative by E[x² + y²] in f64: images (x, y), window and zeros outside as the kernel has them.
    fn exact(image: &[[f32; 2]], at: usize) -> f64 {
        let (row, column) = (at / SIDE, at % SIDE);
        let mut m = [0.0; 4];
        for (i, [x, y]) in image.iter().map(|v| v.map(f64::from)).enumerate() {
            let [v, u] = [i / SIDE + 5, i % SIDE + 5];
            if (row..=row + 10).contains(&v) && (column..=column + 10).contains(&u) {
                let w = f64::from(WINDOW[v - row]) * f64::from(WINDOW[u - column]);
                [x, x - y, (x - y).powi(2), x * x + y * y].iter().zip(&mut m).for_each(|(a, m)| *m += w * a);
            }
        }
        let [x, d, dd, sum] = m;
        let y = x - d;
        let b_1 = x * x + y * y + f64::from(SSIM_C1);
        let b_2 = (sum - x * x - y * y).max(0.0) + f64::from(SSIM_C2);
        (1.0 - d * d / b_1) * (dd - d * d).max(0.0) / (b_2 * b_2)
    }

    #[test]
    fn in_flat_images_that_are_apart_rounding_decides_the_derivative() {
        let ripple = |i: usize| 0.004 * ((i * 37 % 101) as f32 / 101.0 - 0.5);
        let image: Vec<[f32; 2]> = (0..SIDE * SIDE).map(|i| [0.71 + ripple(i), 0.4 + ripple(i + 50)]).collect();
        let moments: Vec<[f32; 4]> = image.iter().map(|&[x, y]| [x, x - y, (x - y) * (x - y), x * x + y * y]).collect();
        let moments = convolve(&moments, SIDE, SIDE);
        // Away from the edges, where zeros outside make variances large.
        let is_inside = |i: &usize| [i / SIDE, i % SIDE].iter().all(|k| (5..SIDE - 5).contains(k));
        let off = |i: usize| (f64::from(ssim_and_derivatives(moments[i])[2]) - exact(&image, i)).abs();
        let worst = (0..SIDE * SIDE).filter(is_inside).map(off).fold(0.0, f64::max);
        assert!((0.005..0.05).contains(&worst), "{worst}");
    }
}

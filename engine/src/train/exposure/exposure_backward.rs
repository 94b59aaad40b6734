//! Kernel `exposure_backward`: gradients back through a photo's exposure.

use super::{EXPOSURE_PIXELS, EXPOSURE_THREADS, EXPOSURE_VALUES, matrix};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::frame::Frame;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::step::Step;

crate::gpu_buffers! {
    /// Buffers of [`EXPOSURE_BACKWARD`].
    pub struct ExposureBackwardBuffers {
        /// Size.
        frame: Read Struct(Frame),
        /// Whose exposure.
        step: Read Struct(Step),
        /// `[photos][40]` ([`EXPOSURE_WORDS`](super::EXPOSURE_WORDS)).
        exposure: Read F32,
        /// `vec4[H·W]` rendered image.
        color: Read F32,
        /// `vec4[H·W]`: by the mapped image before, by the rendered one after; w = 0.
        image_gradient: Update F32,
        /// `[workgroups][12]` sums of the gradient by the map.
        exposure_partial: Write F32,
    }
}

crate::kernel! {
    /// Aᵀ·g, and sums of g·(c, 1)ᵀ. Dispatch ceil(H·W / 2048) workgroups.
    pub static EXPOSURE_BACKWARD: ExposureBackward = {
        name: "exposure_backward",
        doc: "gradients of the loss by the rendered image and by the exposure of the step's photo",
        local_size: EXPOSURE_THREADS,
        constants: (),
        push: (),
        buffers: ExposureBackwardBuffers,
        twin: exposure_backward_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-4, flips: 0.0 },
        bytes: |work| 48 * work.get("pixels"),
    }
}

fn exposure_backward_twin(call: Call<'_, ExposureBackward>) {
    let Call { buffers: b, .. } = call;
    let [width, height] = struct_at::<Frame>(b.frame, 0).size;
    let map = matrix(b.exposure, struct_at::<Step>(b.step, 0).exposure);
    let pixels = (width * height) as usize;
    for group in 0..pixels.div_ceil(EXPOSURE_PIXELS as usize) {
        let first = group * EXPOSURE_PIXELS as usize;
        let mut sums = [0.0_f64; EXPOSURE_VALUES];
        for i in first..pixels.min(first + EXPOSURE_PIXELS as usize) {
            let g = [0, 1, 2].map(|k| f32_at(b.image_gradient, 4 * i + k));
            if g != [0.0; 3] {
                let x = [f32_at(b.color, 4 * i), f32_at(b.color, 4 * i + 1), f32_at(b.color, 4 * i + 2), 1.0];
                (0..EXPOSURE_VALUES).for_each(|v| sums[v] += f64::from(g[v / 4]) * f64::from(x[v % 4]));
            }
            for k in 0..3 {
                set_f32(b.image_gradient, 4 * i + k, g[0] * map[0][k] + g[1] * map[1][k] + g[2] * map[2][k]);
            }
            set_f32(b.image_gradient, 4 * i + 3, 0.0);
        }
        (0..EXPOSURE_VALUES).for_each(|v| set_f32(b.exposure_partial, group * EXPOSURE_VALUES + v, sums[v] as f32));
    }
}

//! Kernel `expose`: the rendered image as the step's photo was exposed.

use super::{EXPOSURE_THREADS, matrix};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::frame::Frame;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::step::Step;

crate::gpu_buffers! {
    /// Buffers of [`EXPOSE`].
    pub struct ExposeBuffers {
        /// Size.
        frame: Read Struct(Frame),
        /// Whose exposure.
        step: Read Struct(Step),
        /// `[photos][40]` ([`EXPOSURE_WORDS`](super::EXPOSURE_WORDS)).
        exposure: Read F32,
        /// `vec4[H·W]` rendered image.
        color: Read F32,
        /// `vec4[H·W]`: the fourth component stays.
        exposed: Write F32,
    }
}

crate::kernel! {
    /// c' = A·c + b. Dispatch ceil(H·W / 256) workgroups.
    pub static EXPOSE: Expose = {
        name: "expose",
        doc: "rendered image mapped by the exposure of the step's photo",
        local_size: EXPOSURE_THREADS,
        constants: (),
        push: (),
        buffers: ExposeBuffers,
        twin: expose_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-6, flips: 0.0 },
        bytes: |work| 32 * work.get("pixels"),
    }
}

fn expose_twin(call: Call<'_, Expose>) {
    let Call { buffers: b, .. } = call;
    let [width, height] = struct_at::<Frame>(b.frame, 0).size;
    let map = matrix(b.exposure, struct_at::<Step>(b.step, 0).exposure);
    for i in 0..(width * height) as usize {
        let c = [0, 1, 2, 3].map(|k| f32_at(b.color, 4 * i + k));
        for (k, row) in map.iter().enumerate() {
            set_f32(b.exposed, 4 * i + k, row[0] * c[0] + row[1] * c[1] + row[2] * c[2] + row[3]);
        }
        set_f32(b.exposed, 4 * i + 3, c[3]);
    }
}

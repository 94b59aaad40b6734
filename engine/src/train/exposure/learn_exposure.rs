//! Kernel `learn_exposure`: Adam of the exposure of the step's photo.

use super::{
    BETA, EPSILON, EXPOSURE_DECAY, EXPOSURE_MOMENT_1, EXPOSURE_MOMENT_2, EXPOSURE_PIXELS, EXPOSURE_THREADS,
    EXPOSURE_VALUES, EXPOSURE_WORDS,
};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::frame::Frame;
use crate::render::limits::COUNT_FAILED;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::status;
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of [`LEARN_EXPOSURE`].
    pub struct LearnExposurePush {
        /// λ of the term that holds the map to the identity.
        pub hold: f32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LEARN_EXPOSURE`].
    pub struct LearnExposureBuffers {
        /// Size.
        frame: Read Struct(Frame),
        /// Whose exposure, and its rate.
        step: Read Struct(Step),
        /// `[photos][40]` ([`EXPOSURE_WORDS`]).
        exposure: Update F32,
        /// `[workgroups][12]` of [`exposure_backward`](super::exposure_backward).
        exposure_partial: Read F32,
        /// Nothing changes when the frame failed.
        counters: Read U32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// A step of Adam for one photo's map. Dispatch one workgroup.
    pub static LEARN_EXPOSURE: LearnExposure = {
        name: "learn_exposure",
        doc: "Adam of the exposure of the step's photo, from the sums of workgroups",
        local_size: EXPOSURE_THREADS,
        constants: (),
        push: LearnExposurePush,
        buffers: LearnExposureBuffers,
        twin: learn_exposure_twin,
        tolerance: Tolerance { absolute: 2e-6, relative: 1e-4, flips: 0.0 },
        bytes: |work| 8 * EXPOSURE_WORDS as u64 + work.get("pixels").div_ceil(EXPOSURE_PIXELS.into()) * 48,
    }
}

fn learn_exposure_twin(call: Call<'_, LearnExposure>) {
    let Call { push, buffers: b, .. } = call;
    let [width, height] = struct_at::<Frame>(b.frame, 0).size;
    let step: Step = struct_at(b.step, 0);
    if b.counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    let groups = (width * height).div_ceil(EXPOSURE_PIXELS) as usize;
    let row = EXPOSURE_WORDS * step.exposure as usize;
    let decay = [0, 1].map(|k| f32_at(b.exposure, row + EXPOSURE_DECAY + k) * BETA[k]);
    for value in 0..EXPOSURE_VALUES {
        let sum = (0..groups).map(|g| f64::from(f32_at(b.exposure_partial, g * EXPOSURE_VALUES + value))).sum::<f64>();
        let own = f32_at(b.exposure, row + value);
        let gradient = sum as f32 + push.hold * (own - f32::from(u8::from(value % 5 == 0)));
        if !gradient.is_finite() {
            status::report(b.status, status::IMAGE_GRADIENT, step.exposure);
            continue;
        }
        let moment_1 = BETA[0] * f32_at(b.exposure, row + EXPOSURE_MOMENT_1 + value) + (1.0 - BETA[0]) * gradient;
        let moment_2 =
            BETA[1] * f32_at(b.exposure, row + EXPOSURE_MOMENT_2 + value) + (1.0 - BETA[1]) * gradient * gradient;
        set_f32(b.exposure, row + EXPOSURE_MOMENT_1 + value, moment_1);
        set_f32(b.exposure, row + EXPOSURE_MOMENT_2 + value, moment_2);
        let size = (moment_2 / (1.0 - decay[1])).sqrt() + EPSILON;
        set_f32(b.exposure, row + value, own - step.rate_exposure * moment_1 / ((1.0 - decay[0]) * size));
    }
    (0..2).for_each(|k| set_f32(b.exposure, row + EXPOSURE_DECAY + k, decay[k]));
}

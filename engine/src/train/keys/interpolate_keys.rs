//! Kernel `interpolate_keys`: poses at a step's time from key poses under training.

use super::{KEY_PLACE, KEY_ROTATION, KEY_WORDS};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::quaternion::{displacement, exp};
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::step::Step;

crate::gpu_buffers! {
    /// Buffers of [`INTERPOLATE_KEYS`].
    pub struct InterpolateKeysBuffers {
        /// M, the keys around the image's time and the weight of the second.
        step: Read Struct(Step),
        /// `[T][22][M]` ([`KEY_WORDS`]).
        key: Read F32,
        /// `[5][M]`: centres are the first three planes.
        key_superpoint: Read F32,
        /// `vec4[M][2]`: (r, 0), (τ, 0).
        pose: Write F32,
    }
}

crate::kernel! {
    /// Rotation vector and translation, linear between two keys, as where a table is played. Dispatch ceil(M / 256) workgroups.
    pub static INTERPOLATE_KEYS: InterpolateKeys = {
        name: "interpolate_keys",
        doc: "poses of superpoints at the step's time, between the key poses that learn",
        local_size: 256,
        constants: (),
        push: (),
        buffers: InterpolateKeysBuffers,
        twin: interpolate_keys_twin,
        tolerance: Tolerance { absolute: 2e-6, relative: 1e-6, flips: 0.0 },
        bytes: |work| work.get("superpoints") * 4 * (12 + 3 + 8),
    }
}

fn interpolate_keys_twin(call: Call<'_, InterpolateKeys>) {
    let Call { buffers: b, .. } = call;
    let step: Step = struct_at(b.step, 0);
    let (m, weight) = (step.superpoints as usize, step.key_weight);
    let words = |at: u32, word: usize, j: usize| -> [f32; 3] {
        [0, 1, 2].map(|c| f32_at(b.key, (at as usize * KEY_WORDS + word + c) * m + j))
    };
    let lerp = |p: [f32; 3], q: [f32; 3]| [0, 1, 2].map(|c| (1.0 - weight) * p[c] + weight * q[c]);
    for j in 0..m {
        let center = [0, 1, 2].map(|c| f32_at(b.key_superpoint, c * m + j));
        let translation = |at: u32| {
            let (place, shift) = (words(at, KEY_PLACE, j), displacement(exp(words(at, KEY_ROTATION, j)), center));
            [0, 1, 2].map(|c| place[c] - (center[c] + shift[c]))
        };
        let ends = [step.key_first, step.key_second];
        let [r, tau] = [ends.map(|at| words(at, KEY_ROTATION, j)), ends.map(translation)].map(|[p, q]| lerp(p, q));
        let row = [r[0], r[1], r[2], 0.0, tau[0], tau[1], tau[2], 0.0];
        row.into_iter().enumerate().for_each(|(c, v)| set_f32(b.pose, 8 * j + c, v));
    }
}

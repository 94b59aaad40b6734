//! Kernel `superpoint_gradient`.

use super::superpoint_sum::{FIRST_OWN_VALUE, FIRST_PAIR_VALUE};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::{quaternion, twin};
use crate::train::status;
use crate::train::step::Step;

crate::gpu_constants! {
    /// Specialisation constants of [`SUPERPOINT_GRADIENT`].
    pub struct SuperpointGradientConstants {
        /// 0: rendering only; 1: the code's property losses; 2: the paper's.
        properties,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SUPERPOINT_GRADIENT`].
    pub struct SuperpointGradientBuffers {
        /// Counts.
        step: Read Struct(Step),
        /// `vec4[M][2]`.
        pose: Read F32,
        /// `[M][3]` canonical centres.
        superpoint_position: Read F32,
        /// `[22][M]` of the property losses ([`super::superpoint_sum`]); absent without them.
        property_sum: optional Read F32,
        /// `[22][M]` of the rendering's gradients by the pose.
        pose_sum: Read F32,
        /// `[6][M]`: dL/dr, dL/dτ.
        superpoint_gradient: Write F32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// Gradient of each superpoint's pose. Dispatch ceil(M / 256) workgroups.
    pub static SUPERPOINT_GRADIENT: SuperpointGradient = {
        name: "superpoint_gradient",
        doc: "gradient of each superpoint's so(3) vector and translation, from rendering and property losses",
        local_size: 256,
        constants: SuperpointGradientConstants,
        push: (),
        buffers: SuperpointGradientBuffers,
        twin: superpoint_gradient_twin,
        tolerance: Tolerance { absolute: 1e-5, relative: 1e-5, flips: 0.0 },
        bytes: |w| 4 * (8 + 3 + 15 + 6 + 6) * w.get("superpoints"),
    }
}

fn superpoint_gradient_twin(call: Call<'_, SuperpointGradient>) {
    let Call { constants, buffers: b, .. } = call;
    let property_sum = b.property_sum.as_deref().unwrap_or_default();
    let step: Step = twin::struct_at(b.step, 0);
    let m = step.superpoints as usize;
    for j in 0..m {
        let sums = |words: &[u32], plane: usize| [0, 1, 2].map(|c| twin::f32_at(words, (plane + c) * m + j));
        let property = |plane: usize| sums(property_sum, plane);
        let [rx, ry, rz, _] = twin::vec4_at(b.pose, 2 * j);
        let r = [rx, ry, rz];
        let mut tangent = sums(b.pose_sum, FIRST_OWN_VALUE);
        let mut vector = [0.0_f32; 3];
        let mut translation = sums(b.pose_sum, FIRST_OWN_VALUE + 3);
        match constants.properties {
            1 => {
                let x = [0, 1, 2].map(|c| twin::f32_at(b.superpoint_position, 3 * j + c));
                let pull = property(FIRST_PAIR_VALUE).map(|v| -v);
                let shift = quaternion::displacement(quaternion::exp(r), x);
                let turn = quaternion::cross([0, 1, 2].map(|c| x[c] + shift[c]), pull);
                let (own_r, own_t) = (property(FIRST_OWN_VALUE), property(FIRST_OWN_VALUE + 3));
                let (pair_r, pair_t) = (property(FIRST_PAIR_VALUE + 3), property(FIRST_PAIR_VALUE + 6));
                for c in 0..3 {
                    tangent[c] += turn[c];
                    vector[c] += own_r[c] - pair_r[c];
                    translation[c] += pull[c] + own_t[c] - pair_t[c];
                }
            }
            2 => {
                for c in 0..3 {
                    tangent[c] += property(FIRST_OWN_VALUE)[c];
                    vector[c] += property(FIRST_OWN_VALUE + 3)[c];
                    translation[c] += property(FIRST_OWN_VALUE + 6)[c];
                }
            }
            _ => {}
        }
        let turned = quaternion::left_jacobian_transposed(r, tangent);
        let mut result: [f32; 6] =
            std::array::from_fn(|c| if c < 3 { vector[c] + turned[c] } else { translation[c - 3] });
        if !result.iter().map(|v| v.abs()).sum::<f32>().is_finite() {
            status::report(b.status, status::POSE, j as u32);
            result = [0.0; 6];
        }
        result.into_iter().enumerate().for_each(|(c, v)| twin::set_f32(b.superpoint_gradient, c * m + j, v));
    }
}

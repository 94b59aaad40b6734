//! Kernel `property_backward`: the paper's form.

use super::{Properties, inverse_weight, mean_properties, moved_properties, planes, update_logit};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::limits::COUNT_FAILED;
use crate::render::quaternion::{cross, displacement, dot, exp};
use crate::render::twin;
use crate::train::association::superpoint_sum::FIRST_PAIR_VALUE;
use crate::train::association::{AssociationConstants, NO_SUPERPOINT};
use crate::train::step::Step;

crate::gpu_buffers! {
    /// Buffers of [`PROPERTY_BACKWARD`].
    pub struct PropertyBackwardBuffers {
        /// Counts and loss weights.
        step: Read Struct(Step),
        /// A failed frame leaves the logits as they are.
        counters: Read U32,
        /// `[3][N]` canonical centres.
        mean: Read F32,
        /// `[N]`.
        superpoint_of_gaussian: Read U32,
        /// `vec4[M][2]`.
        pose: Read F32,
        /// `[22][M]`: Σa and Σa·properties ([`crate::train::association::superpoint_sum`]).
        property_sum: Read F32,
        /// `[22][M]`: Σa·residual.
        residual_sum: Read F32,
        /// `[N][K']`.
        neighbor: Read U32,
        /// `[K][N]`.
        weight: Read F32,
        /// `[N][K']`.
        logit: Update F32,
        /// `[N][K']`.
        logit_moment_1: Update F32,
        /// `[N][K']`.
        logit_moment_2: Update F32,
        /// `[N][9]` of `property_residual`.
        residual: Read F32,
        /// `[N][9]`: gradient by the own superpoint's rotation (a left tangent), so(3) vector and translation.
        own_gradient: Write F32,
        /// `[3][N]`: gradient by the canonical centre.
        property_mean_gradient: Write F32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// Backward through both reconstructions. Dispatch ceil(N / 256) workgroups.
    pub static PROPERTY_BACKWARD: PropertyBackward = {
        name: "property_backward",
        doc: "backward of the paper's property losses: logits with Adam, own poses, means",
        local_size: 256,
        constants: AssociationConstants,
        push: (),
        buffers: PropertyBackwardBuffers,
        twin: property_backward_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-4, flips: 0.0 },
        bytes: |w| (12 + 4 + 72 + 12 + 8 * w.get("neighbors") + 24 * w.get("slots")) * w.get("gaussians"),
    }
}

fn property_backward_twin(call: Call<'_, PropertyBackward>) {
    let Call { constants, buffers: b, .. } = call;
    let (k, slots) = (constants.neighbors as usize, constants.slots as usize);
    let step: Step = twin::struct_at(b.step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    for i in 0..n {
        let s = b.superpoint_of_gaussian[i].min(step.superpoints - 1) as usize;
        let Properties { turned, value } = moved_properties(b.pose, s, planes(b.mean, 0, n, i));
        let g = [0, 3, 6].map(|p| std::array::from_fn(|c| twin::f32_at(b.residual, 9 * i + p + c)));
        let mut d = g;
        let (mut d_a, mut d_total) = (vec![0.0_f32; k], 0.0);
        let a: Vec<f32> = (0..k).map(|k| twin::f32_at(b.weight, k * n + i)).collect();
        for k in 0..k {
            let j = b.neighbor[i * slots + k].min(step.superpoints - 1) as usize;
            let u = mean_properties(b.property_sum, m, j);
            let inverse = inverse_weight(b.property_sum, j);
            for p in 0..3 {
                let pull = planes(b.residual_sum, FIRST_PAIR_VALUE + 3 * p, m, j).map(|v| -inverse * v);
                let both: [f32; 3] = std::array::from_fn(|c| g[p][c] + pull[c]);
                d_a[k] += dot(both, std::array::from_fn(|c| value[p][c] - u[p][c]));
                (0..3).for_each(|c| d[p][c] += a[k] * pull[c]);
            }
            d_total += a[k] * d_a[k];
        }
        let pose_gradient = [cross(turned, d[0]), d[1], std::array::from_fn(|c| d[0][c] + d[2][c])];
        pose_gradient.as_flattened().iter().enumerate().for_each(|(c, x)| twin::set_f32(b.own_gradient, 9 * i + c, *x));
        let back = displacement(exp(value[1].map(|r| -r)), d[0]);
        (0..3).for_each(|c| twin::set_f32(b.property_mean_gradient, c * n + i, d[0][c] + back[c]));
        if b.counters[COUNT_FAILED as usize] == 0 {
            for (slot, at) in (i * slots..(i + 1) * slots).enumerate() {
                if slot < k || b.neighbor[at] != NO_SUPERPOINT {
                    let g = if slot < k { a[slot] * (d_a[slot] - d_total) } else { 0.0 };
                    update_logit(&step, [b.logit, b.logit_moment_1, b.logit_moment_2], at, g, b.status, i);
                }
            }
        }
    }
}

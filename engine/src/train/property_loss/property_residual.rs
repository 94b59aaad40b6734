//! Kernel `property_residual`.

use super::{Properties, mean_properties, moved_properties, planes, update_logit};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::limits::COUNT_FAILED;
use crate::render::quaternion::dot;
use crate::render::twin;
use crate::train::association::NO_SUPERPOINT;
use crate::train::step::Step;

crate::gpu_constants! {
    /// Specialisation constants of [`PROPERTY_RESIDUAL`].
    pub struct PropertyResidualConstants {
        /// K, superpoints in use per Gaussian.
        neighbors,
        /// K', superpoints remembered per Gaussian.
        slots,
        /// 1: the superpoints' properties are means over Gaussians, and the logits stay.
        paper,
        /// 1: the logits' gradient goes to `logit_gradient` instead, and
        /// [`association_update`](crate::train::association::association_update) adds to it.
        defer,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`PROPERTY_RESIDUAL`].
    pub struct PropertyResidualBuffers {
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
        /// `[M][3]` canonical centres.
        superpoint_position: Read F32,
        /// `[22][M]`: Σa and Σa·properties ([`crate::train::association::superpoint_sum`]); absent in the code's form.
        property_sum: optional Read F32,
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
        /// `[N][9]`: dL/d properties.
        residual: Write F32,
        /// `vec4[workgroups]`: sums of squares of the three properties.
        loss_partial: Write F32,
        status: Atomic U32,
        /// `[K][N]`; of soft superpoints.
        logit_gradient: optional Write F32,
    }
}

crate::kernel! {
    /// Residuals and losses; in the code's form also the logits' update. Dispatch ceil(N / 256) workgroups.
    pub static PROPERTY_RESIDUAL: PropertyResidual = {
        name: "property_residual",
        doc: "property losses: residuals of each Gaussian's reconstructed properties; logits' Adam in the code's form",
        local_size: 256,
        constants: PropertyResidualConstants,
        push: (),
        buffers: PropertyResidualBuffers,
        twin: property_residual_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-4, flips: 0.0 },
        bytes: |w| (12 + 4 + 36 + 8 * w.get("neighbors") + 24 * w.get("slots")) * w.get("gaussians"),
    }
}

fn property_residual_twin(call: Call<'_, PropertyResidual>) {
    let Call { constants, buffers: mut b, .. } = call;
    let (k, slots) = (constants.neighbors as usize, constants.slots as usize);
    let step: Step = twin::struct_at(b.step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    let mut squares = vec![[0.0_f64; 3]; n.div_ceil(256)];
    for i in 0..n {
        let s = b.superpoint_of_gaussian[i].min(step.superpoints - 1) as usize;
        let Properties { value, .. } = moved_properties(b.pose, s, planes(b.mean, 0, n, i));
        let a: Vec<f32> = (0..k).map(|k| twin::f32_at(b.weight, k * n + i)).collect();
        let u: Vec<[[f32; 3]; 3]> = (0..k)
            .map(|k| match (b.neighbor[i * slots + k].min(step.superpoints - 1) as usize, &b.property_sum) {
                (j, Some(property_sum)) if constants.paper != 0 => mean_properties(property_sum, m, j),
                (j, _) => {
                    let x = [0, 1, 2].map(|c| twin::f32_at(b.superpoint_position, 3 * j + c));
                    moved_properties(b.pose, j, x).value
                }
            })
            .collect();
        let mut gradient = vec![0.0; k];
        for p in 0..3 {
            let rebuilt: [f32; 3] = std::array::from_fn(|c| (0..k).map(|k| a[k] * u[k][p][c]).sum());
            let error: [f32; 3] = std::array::from_fn(|c| value[p][c] - rebuilt[c]);
            squares[i / 256][p] += f64::from(dot(error, error));
            let scale = step.property_weights()[p] * (2.0 / (3.0 * n as f32));
            let g = error.map(|e| scale * e);
            g.iter().enumerate().for_each(|(c, v)| twin::set_f32(b.residual, 9 * i + 3 * p + c, *v));
            for k in 0..k {
                gradient[k] -= a[k] * dot(g, std::array::from_fn(|c| u[k][p][c] - rebuilt[c]));
            }
        }
        if constants.paper == 0 && b.counters[COUNT_FAILED as usize] == 0 {
            if let Some(to) = b.logit_gradient.as_deref_mut().filter(|_| constants.defer != 0) {
                gradient.iter().enumerate().for_each(|(k, g)| twin::set_f32(to, k * n + i, *g));
                continue;
            }
            for (slot, at) in (i * slots..(i + 1) * slots).enumerate() {
                if slot < k || b.neighbor[at] != NO_SUPERPOINT {
                    let g = gradient.get(slot).copied().unwrap_or(0.0);
                    update_logit(&step, [b.logit, b.logit_moment_1, b.logit_moment_2], at, g, b.status, i);
                }
            }
        }
    }
    for (group, values) in squares.iter().enumerate() {
        values.iter().enumerate().for_each(|(c, v)| twin::set_f32(b.loss_partial, 4 * group + c, *v as f32));
    }
}

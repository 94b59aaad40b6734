//! Kernel `association_update`.

use super::NO_SUPERPOINT;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::limits::COUNT_FAILED;
use crate::render::twin;
use crate::train::deform_project_backward::SLOT_PLANES;
use crate::train::property_loss::update_logit;
use crate::train::step::Step;

crate::gpu_constants! {
    /// Specialisation constants of [`ASSOCIATION_UPDATE`].
    pub struct AssociationUpdateConstants {
        /// K, superpoints in use per Gaussian.
        neighbors,
        /// K', superpoints remembered per Gaussian.
        slots,
        /// 1: `logit_gradient` is added.
        property,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`ASSOCIATION_UPDATE`].
    pub struct AssociationUpdateBuffers {
        /// Counts and rate.
        step: Read Struct(Step),
        /// A failed frame leaves the logits as they are.
        counters: Read U32,
        /// `[N][K']`.
        neighbor: Read U32,
        /// `[K][N]` softmax of the logits in use.
        weight: Read F32,
        /// `[K][7][N]`: plane 6 of each slot is the gradient of its weight with the others held.
        pose_gradient: Read F32,
        /// `[N][K']`.
        logit: Update F32,
        /// `[N][K']`.
        logit_moment_1: Update F32,
        /// `[N][K']`.
        logit_moment_2: Update F32,
        status: Atomic U32,
        /// `[K][N]` of the property losses.
        logit_gradient: optional Read F32,
    }
}

crate::kernel! {
    /// Adam of the logits that are the weights of soft superpoints: dL/dl_k = a_k (dL/da_k − Σ_j a_j dL/da_j), and what the
    /// property losses left. Dispatch ceil(N / 256) workgroups.
    pub static ASSOCIATION_UPDATE: AssociationUpdate = {
        name: "association_update",
        doc: "Adam of the logits of soft superpoints, from the gradients of their weights",
        local_size: 256,
        constants: AssociationUpdateConstants,
        push: (),
        buffers: AssociationUpdateBuffers,
        twin: association_update_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-4, flips: 0.0 },
        bytes: |w| (12 * w.get("neighbors") + 28 * w.get("slots")) * w.get("gaussians"),
    }
}

fn association_update_twin(call: Call<'_, AssociationUpdate>) {
    let Call { constants, buffers: b, .. } = call;
    let (k, slots) = (constants.neighbors as usize, constants.slots as usize);
    let step: Step = twin::struct_at(b.step, 0);
    let n = step.gaussians as usize;
    if b.counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    for i in 0..n {
        let plane = |words: &[u32], plane: usize| twin::f32_at(words, plane * n + i);
        let a: Vec<f32> = (0..k).map(|s| plane(b.weight, s)).collect();
        let of_weight: Vec<f32> = (0..k).map(|s| plane(b.pose_gradient, (s + 1) * SLOT_PLANES as usize - 1)).collect();
        let mean: f32 = a.iter().zip(&of_weight).map(|(a, g)| a * g).sum();
        for (slot, at) in (i * slots..(i + 1) * slots).enumerate() {
            let mut gradient = 0.0;
            if slot < k {
                gradient = a[slot] * (of_weight[slot] - mean);
                if let Some(property) = b.logit_gradient.as_deref().filter(|_| constants.property != 0) {
                    gradient += plane(property, slot);
                }
            }
            if slot < k || b.neighbor[at] != NO_SUPERPOINT {
                update_logit(&step, [b.logit, b.logit_moment_1, b.logit_moment_2], at, gradient, b.status, i);
            }
        }
    }
}

//! Kernel `association_init`.

use super::AssociationConstants;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::twin;
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of [`ASSOCIATION_INIT`].
    pub struct AssociationInitPush {
        /// Logit of the chosen entries.
        pub logit: f32,
        /// 0: the nearest superpoint of every Gaussian; 1: the superpoint that the Gaussian seeded.
        pub paper: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`ASSOCIATION_INIT`].
    pub struct AssociationInitBuffers {
        /// Counts.
        step: Read Struct(Step),
        /// `[N][K']`, nearest first.
        neighbor: Read U32,
        /// `[M]` the Gaussian that seeded each superpoint.
        chosen: Read U32,
        /// `[N][K']`.
        logit: Update F32,
        /// `[N]`.
        superpoint_of_gaussian: Write U32,
    }
}

crate::kernel! {
    /// First assignment and logits. Dispatch ceil(gaussians / 256) workgroups after `nearest_superpoints`.
    pub static ASSOCIATION_INIT: AssociationInit = {
        name: "association_init",
        doc: "assigns every Gaussian to its nearest superpoint and sets the first logits",
        local_size: 256,
        constants: AssociationConstants,
        push: AssociationInitPush,
        buffers: AssociationInitBuffers,
        twin: association_init_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| (4 + 4 * w.get("neighbors")) * w.get("gaussians"),
    }
}

fn association_init_twin(call: Call<'_, AssociationInit>) {
    let Call { constants, push, buffers: b, .. } = call;
    let (k, slots) = (constants.neighbors as usize, constants.slots as usize);
    let step: Step = twin::struct_at(b.step, 0);
    for i in 0..step.gaussians as usize {
        b.superpoint_of_gaussian[i] = b.neighbor[i * slots];
        for s in 0..k {
            let at = i * slots + s;
            let pick = if push.paper == 0 { s == 0 } else { b.chosen[b.neighbor[at] as usize] == i as u32 };
            if pick {
                twin::set_f32(b.logit, at, push.logit);
            }
        }
    }
}

//! Kernel `superpoint_commit`.

use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::limits::COUNT_FAILED;
use crate::render::twin;
use crate::train::status;
use crate::train::step::Step;

/// Least sum of weights that a centre is divided by.
const LEAST_WEIGHT: f32 = 1e-5;

crate::gpu_buffers! {
    /// Buffers of [`SUPERPOINT_COMMIT`].
    pub struct SuperpointCommitBuffers {
        /// Counts.
        step: Read Struct(Step),
        /// Nothing changes when the frame failed.
        counters: Read U32,
        /// `[22][M]`: Σa and Σa·mean ([`super::superpoint_sum`]).
        superpoint_sum: Read F32,
        /// `[N]`.
        next_superpoint: Read U32,
        /// `[N]`.
        superpoint_of_gaussian: Update U32,
        /// `[M][3]` canonical centres.
        superpoint_position: Update F32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// What the next step uses. Dispatch ceil(max(N, M) / 256) workgroups.
    pub static SUPERPOINT_COMMIT: SuperpointCommit = {
        name: "superpoint_commit",
        doc: "sets the assignment and the superpoint centres of the next step",
        local_size: 256,
        constants: (),
        push: (),
        buffers: SuperpointCommitBuffers,
        twin: superpoint_commit_twin,
        tolerance: Tolerance { absolute: 0.0, relative: 5e-7, flips: 0.0 },
        bytes: |w| 8 * w.get("gaussians"),
    }
}

fn superpoint_commit_twin(call: Call<'_, SuperpointCommit>) {
    let Call { buffers: b, .. } = call;
    let step: Step = twin::struct_at(b.step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    if b.counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    b.superpoint_of_gaussian[..n].copy_from_slice(&b.next_superpoint[..n]);
    for j in 0..m {
        let total = twin::f32_at(b.superpoint_sum, j);
        let center = [1, 2, 3].map(|p| twin::f32_at(b.superpoint_sum, p * m + j) / total.max(LEAST_WEIGHT));
        let finite = center.iter().all(|c| c.is_finite());
        if total > 0.0 && finite {
            center.into_iter().enumerate().for_each(|(c, v)| twin::set_f32(b.superpoint_position, 3 * j + c, v));
        } else if !finite {
            status::report(b.status, status::POSE, j as u32);
        }
    }
}

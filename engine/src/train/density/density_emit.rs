//! Kernel `density_emit`: where the new rows come from.

use super::{ACTION_SPLIT, DENSITY_BLOCK, KIND_CHILD_0, KIND_CLONE, KIND_KEPT, rows_of_action};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_struct! {
    /// Push constants of `density_emit`.
    pub struct DensityEmitPush {
        /// N.
        pub gaussians: u32,
        /// Words of `source`.
        pub rows: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`DENSITY_EMIT`].
    pub struct DensityEmitBuffers {
        /// `uint[N]`, as `density_decide` leaves it.
        action: Read U32,
        /// As `density_scan` leaves it.
        row_block: Read U32,
        /// Old row ([`SOURCE_ROW`](super::SOURCE_ROW)) and kind of each new row.
        source: Write U32,
    }
}

crate::kernel! {
    /// Dispatch ceil(N / 256) workgroups after `density_scan`.
    pub static DENSITY_EMIT: DensityEmit = {
        name: "density_emit",
        doc: "old row and kind of each new row, in the order of the old rows",
        local_size: DENSITY_BLOCK,
        constants: (),
        push: DensityEmitPush,
        buffers: DensityEmitBuffers,
        twin: density_emit_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 8 * w.get("gaussians"),
    }
}

fn density_emit_twin(call: Call<'_, DensityEmit>) {
    let Call { push, buffers: b, .. } = call;
    let mut to = 0;
    for i in 0..push.gaussians {
        if i % DENSITY_BLOCK == 0 {
            to = b.row_block[(i / DENSITY_BLOCK) as usize];
        }
        let what = b.action[i as usize];
        let kinds = if what == ACTION_SPLIT { [KIND_CHILD_0, KIND_CHILD_0 + 1] } else { [KIND_KEPT, KIND_CLONE] };
        for kind in &kinds[..rows_of_action(what) as usize] {
            if to < push.rows {
                b.source[to as usize] = i | kind << 30;
            }
            to += 1;
        }
    }
}

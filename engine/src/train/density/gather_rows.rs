//! Kernel `gather_rows`: moves the rows of an array to their new places.

use super::{KIND_KEPT, SOURCE_ROW};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_struct! {
    /// Push constants of `gather_rows`.
    pub struct GatherRowsPush {
        /// Rows of the old array.
        pub old_count: u32,
        /// Rows of the new one.
        pub new_count: u32,
        /// Planes of both.
        pub planes: u32,
        /// Words per row and plane.
        pub width: u32,
        /// 1: rows of clones and children become 0.
        pub zero_new: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`GATHER_ROWS`].
    pub struct GatherRowsBuffers {
        /// As `density_emit` leaves it.
        source: Read U32,
        /// Any 32-bit words, `[planes][old_count][width]`.
        old_rows: Read U32,
        /// `[planes][new_count][width]`.
        new_rows: Write U32,
    }
}

crate::kernel! {
    /// Dispatch ceil(new rows · width / 256) workgroups.
    pub static GATHER_ROWS: GatherRows = {
        name: "gather_rows",
        doc: "copies rows of an array to their new places; rows of clones and children may become 0",
        local_size: 256,
        constants: (),
        push: GatherRowsPush,
        buffers: GatherRowsBuffers,
        twin: gather_rows_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 12 * w.get("gaussians"),
    }
}

fn gather_rows_twin(call: Call<'_, GatherRows>) {
    let Call { push, buffers: b, .. } = call;
    let [old_count, new_count, planes, width] =
        [push.old_count, push.new_count, push.planes, push.width].map(|v| v as usize);
    for plane in 0..planes {
        for row in 0..new_count {
            let zero = push.zero_new == 1 && b.source[row] >> 30 != KIND_KEPT;
            let from = (b.source[row] & SOURCE_ROW) as usize;
            for c in 0..width {
                let value = if zero { 0 } else { b.old_rows[(plane * old_count + from) * width + c] };
                b.new_rows[(plane * new_count + row) * width + c] = value;
            }
        }
    }
}

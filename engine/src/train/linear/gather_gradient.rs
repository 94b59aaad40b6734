//! Kernel `gather_gradient`: planes to rows.

use super::THREADS;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::twin::{f32_at, set_f32};
use crate::train::status;

crate::gpu_struct! {
    /// Push constants of [`GATHER_GRADIENT`].
    pub struct GatherGradientPush {
        /// Rows to write.
        pub rows: u32,
        /// Element of each plane that becomes the first row.
        pub first_row: u32,
        /// Floats from one plane to the next.
        pub plane_stride: u32,
        /// Columns of network G that get a gradient: 10, or 7 without scale.
        pub columns: u32,
    }
}

crate::gpu_constants! {
    /// Specialisation constants of [`GATHER_GRADIENT`].
    pub struct GatherGradientConstants {
        /// A [`super::Network`].
        network,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`GATHER_GRADIENT`].
    pub struct GatherGradientBuffers {
        /// `[planes][plane_stride]`: 6 planes of F, 10 of G.
        plane: Read F32,
        /// `[rows, 8]` of F, `[rows, 12]` of G.
        row_gradient: Write F32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// Planes to rows. Dispatch ceil(rows · columns / 256) workgroups.
    pub static GATHER_GRADIENT: GatherGradient = {
        name: "gather_gradient",
        doc: "gradient planes of a network's heads to rows, checked",
        local_size: THREADS,
        constants: GatherGradientConstants,
        push: GatherGradientPush,
        buffers: GatherGradientBuffers,
        twin: gather_gradient_twin,
        tolerance: Tolerance::EXACT,
        bytes: |work| 4 * work.get("rows") * (work.get("planes") + work.get("planes").next_multiple_of(4)),
    }
}

fn gather_gradient_twin(call: Call<'_, GatherGradient>) {
    let Call { constants: GatherGradientConstants { network }, push: p, buffers: b, .. } = call;
    let columns = if network == 0 { 8 } else { 12 };
    for item in 0..p.rows * columns {
        let (row, column) = (p.first_row + item / columns, item % columns);
        let plane = match network {
            0 => (column % 4 != 3).then_some(column - column / 4),
            _ => (column < p.columns).then_some(column),
        };
        let value = plane.map_or(0.0, |plane| f32_at(b.plane, (plane * p.plane_stride + row) as usize));
        if !value.is_finite() {
            status::report(b.status, if network == 0 { status::POSE } else { status::NETWORK_G }, row);
        }
        set_f32(b.row_gradient, item as usize, if value.is_finite() { value } else { 0.0 });
    }
}

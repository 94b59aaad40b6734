//! Kernels `density_scan` and `density_emit`: where the new rows come from.

use super::{ACTION_SPLIT, DENSITY_BLOCK, KIND_CHILD_0, KIND_CLONE, KIND_KEPT, rows_of_action};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::twin;

crate::gpu_struct! {
    /// Push constants of `density_scan`.
    pub struct ScanPush {
        /// Words of `row_block`.
        pub blocks: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of `density_emit`.
    pub struct EmitPush {
        /// N.
        pub gaussians: u32,
        /// Words of `source`.
        pub rows: u32,
    }
}

/// Dispatch 1 workgroup.
pub static DENSITY_SCAN: Kernel = Kernel {
    name: "density_scan",
    doc: "exclusive prefix sum of the blocks' row counts, in place",
    local_size: DENSITY_BLOCK,
    spec: &["SUBGROUP_SIZE"],
    push: ScanPush::FIELDS,
    bindings: &[Binding::new("row_block", Access::Update, Element::U32)],
    twin: scan_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 8 * w.get("gaussians") / 256,
    spirv: include_bytes!("../../../../spirv_cache/density_scan.spv"),
};

fn scan_twin(call: &mut TwinCall<'_>) {
    let push: ScanPush = twin::push(call);
    let [row_block] = call.buffers else { return };
    let mut before = 0;
    for count in &mut row_block[..push.blocks as usize] {
        before += std::mem::replace(count, before);
    }
}

/// Dispatch ceil(N / 256) workgroups after `density_scan`.
pub static DENSITY_EMIT: Kernel = Kernel {
    name: "density_emit",
    doc: "old row and kind of each new row, in the order of the old rows",
    local_size: DENSITY_BLOCK,
    spec: &["SUBGROUP_SIZE"],
    push: EmitPush::FIELDS,
    bindings: &[
        Binding::new("action", Access::Read, Element::U32),
        Binding::new("row_block", Access::Read, Element::U32),
        Binding::new("source", Access::Write, Element::U32),
    ],
    twin: emit_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 8 * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/density_emit.spv"),
};

fn emit_twin(call: &mut TwinCall<'_>) {
    let push: EmitPush = twin::push(call);
    let [action, row_block, source] = call.buffers else { return };
    let mut to = 0;
    for i in 0..push.gaussians {
        if i % DENSITY_BLOCK == 0 {
            to = row_block[(i / DENSITY_BLOCK) as usize];
        }
        let what = action[i as usize];
        let kinds = if what == ACTION_SPLIT { [KIND_CHILD_0, KIND_CHILD_0 + 1] } else { [KIND_KEPT, KIND_CLONE] };
        for kind in &kinds[..rows_of_action(what) as usize] {
            if to < push.rows {
                source[to as usize] = i | kind << 30;
            }
            to += 1;
        }
    }
}

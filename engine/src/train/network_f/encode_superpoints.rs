//! Kernel `encode_superpoints`: the input of network F.

use crate::error::Result;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::nonrigid_network::encoded;
use crate::render::twin::{f32_at, push, set_f32, struct_at};
use crate::scene::network::ENCODING_WIDTH;
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of [`ENCODE_SUPERPOINTS`].
    pub struct EncodePush {
        /// Superpoints.
        pub rows: u32,
    }
}

const THREADS: u32 = 256;

/// Positional encoding of the superpoints' centres and the time, `[M, 76]` (SP-GS appendix: 10 and 6 octaves, no π).
pub static ENCODE_SUPERPOINTS: Kernel = Kernel {
    name: "encode_superpoints",
    doc: "positional encoding of superpoint centres and time",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE"],
    push: EncodePush::FIELDS,
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("superpoint_position", Access::Read, Element::F32),
        Binding::new("encoding", Access::Write, Element::F32),
    ],
    twin: encode_twin,
    tolerance: Tolerance { absolute: 2e-6, relative: 0.0, flips: 0.0 },
    bytes: |work| work.get("superpoints") * 4 * (3 + ENCODING_WIDTH as u64),
    spirv: include_bytes!("../../../../spirv_cache/encode_superpoints.spv"),
};

/// Records it; buffers in binding order.
pub(super) fn record(r: &mut Recorder, rows: u32, buffers: [&Slice; 3]) -> Result<()> {
    let groups = (u64::from(rows) * ENCODING_WIDTH as u64).div_ceil(THREADS.into());
    let push = EncodePush { rows };
    r.dispatch_untyped(
        &ENCODE_SUPERPOINTS,
        &[],
        bytemuck::bytes_of(&push),
        &buffers.map(Clone::clone),
        Groups::Direct(groups),
    )
}

fn encode_twin(call: &mut TwinCall<'_>) {
    let EncodePush { rows } = push(call);
    let step: Step = struct_at(&call.buffers[0], 0);
    for row in 0..rows as usize {
        let position = std::array::from_fn(|axis| f32_at(&call.buffers[1], 3 * row + axis));
        for e in 0..ENCODING_WIDTH {
            set_f32(&mut call.buffers[2], row * ENCODING_WIDTH + e, encoded(position, step.time[0], e));
        }
    }
}

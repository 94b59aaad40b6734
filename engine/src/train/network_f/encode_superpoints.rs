//! Kernel `encode_superpoints`: the input of network F.

use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::nonrigid_network::encoded;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::scene::network::ENCODING_WIDTH;
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of [`ENCODE_SUPERPOINTS`].
    pub struct EncodeSuperpointsPush {
        /// Superpoints.
        pub rows: u32,
    }
}

const THREADS: u32 = 256;

crate::gpu_buffers! {
    /// Buffers of [`ENCODE_SUPERPOINTS`].
    pub struct EncodeSuperpointsBuffers {
        /// Time.
        step: Read Struct(Step),
        /// `[M][3]` canonical centres.
        superpoint_position: Read F32,
        /// `[M, 76]`.
        encoding: Write F32,
    }
}

crate::kernel! {
    /// Positional encoding of the superpoints' centres and the time (SP-GS appendix: 10 and 6 octaves, no π). Dispatch
    /// ceil(76 · M / 256) workgroups.
    pub static ENCODE_SUPERPOINTS: EncodeSuperpoints = {
        name: "encode_superpoints",
        doc: "positional encoding of superpoint centres and time",
        local_size: THREADS,
        constants: (),
        push: EncodeSuperpointsPush,
        buffers: EncodeSuperpointsBuffers,
        twin: encode_superpoints_twin,
        tolerance: Tolerance { absolute: 2e-6, relative: 0.0, flips: 0.0 },
        bytes: |work| work.get("superpoints") * 4 * (3 + ENCODING_WIDTH as u64),
    }
}

/// Records it.
pub(super) fn record(r: &mut Recorder, rows: u32, buffers: EncodeSuperpointsBuffers<Slice>) -> Result<()> {
    let groups = (u64::from(rows) * ENCODING_WIDTH as u64).div_ceil(THREADS.into());
    r.dispatch(&ENCODE_SUPERPOINTS, (), EncodeSuperpointsPush { rows }, buffers, Groups::Direct(groups))
}

fn encode_superpoints_twin(call: Call<'_, EncodeSuperpoints>) {
    let Call { push: EncodeSuperpointsPush { rows }, buffers: b, .. } = call;
    let step: Step = struct_at(b.step, 0);
    for row in 0..rows as usize {
        let position = std::array::from_fn(|axis| f32_at(b.superpoint_position, 3 * row + axis));
        for e in 0..ENCODING_WIDTH {
            set_f32(b.encoding, row * ENCODING_WIDTH + e, encoded(position, step.time, e));
        }
    }
}

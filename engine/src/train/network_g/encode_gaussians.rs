//! Kernel `encode_gaussians`: the input of network G, kept for the backward pass.

use super::Inputs;
use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::frame::Frame;
use crate::render::nonrigid_network::{encoded, moved_centre, superpoint_motion};
use crate::render::twin::{set_f32, struct_at};
use crate::scene::network::NONRIGID_ENCODING;

crate::gpu_struct! {
    /// Push constants of [`ENCODE_GAUSSIANS`].
    pub struct EncodeGaussiansPush {
        /// Gaussian of the first row.
        pub first_row: u32,
        /// Rows to write.
        pub rows: u32,
    }
}

/// Gaussians per workgroup.
const GROUP_GAUSSIANS: u32 = 64;

crate::gpu_constants! {
    /// Specialisation constants of [`ENCODE_GAUSSIANS`].
    pub struct EncodeGaussiansConstants {
        /// 1: superpoints move the Gaussians.
        motion,
        /// K of soft superpoints, or 0 ([`crate::render::superpoint_motion`]).
        blend,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`ENCODE_GAUSSIANS`].
    pub struct EncodeGaussiansBuffers {
        /// Time, counts and keys.
        frame: Read Struct(Frame),
        /// `[3][N]` canonical centres.
        mean: Read F32,
        /// `[N]`, of a moving scene.
        superpoint_of_gaussian: optional Read U32,
        /// `vec4[T][M][2]`, of a moving scene.
        pose: optional Read F32,
        /// `[rows, 84]`.
        encoding: Write F32,
        /// `[ceil(K/2)][N]`; of soft superpoints ([`superpoint_motion`](crate::render::superpoint_motion)).
        blend_index: optional Read U32,
        /// `[K-1][N]`; of soft superpoints.
        blend_weight: optional Read F32,
    }
}

crate::kernel! {
    /// Positional encoding of the moved centres and the time. Dispatch ceil(rows / 64) workgroups.
    pub static ENCODE_GAUSSIANS: EncodeGaussians = {
        name: "encode_gaussians",
        doc: "positional encoding of moved centres and time",
        local_size: 256,
        constants: EncodeGaussiansConstants,
        push: EncodeGaussiansPush,
        buffers: EncodeGaussiansBuffers,
        twin: encode_gaussians_twin,
        // Slopes of 2^9 times 8 ulps of a moved centre below 8.
        tolerance: Tolerance { absolute: 4e-3, relative: 0.0, flips: 0.0 },
        bytes: |work| work.get("gaussians") * 4 * (4 + NONRIGID_ENCODING as u64),
    }
}

/// Records it.
pub(super) fn record(r: &mut Recorder, from: &Inputs<'_>, push: EncodeGaussiansPush, encoding: Slice) -> Result<()> {
    let buffers = EncodeGaussiansBuffers {
        frame: from.frame.clone(),
        mean: from.mean.clone(),
        superpoint_of_gaussian: from.hard_superpoints(),
        pose: from.moving.then(|| from.pose.clone()),
        encoding,
        blend_index: from.blend.map(|b| b.index.clone()),
        blend_weight: from.blend.map(|b| b.weight.clone()),
    };
    let constants = EncodeGaussiansConstants { motion: from.moving.into(), blend: from.blend_slots() };
    let groups = Groups::Direct(push.rows.div_ceil(GROUP_GAUSSIANS).into());
    r.dispatch(&ENCODE_GAUSSIANS, constants, push, buffers, groups)
}

fn encode_gaussians_twin(call: Call<'_, EncodeGaussians>) {
    let Call { constants, push: EncodeGaussiansPush { first_row, rows }, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let words =
        [b.superpoint_of_gaussian.as_deref(), b.pose.as_deref(), b.blend_index.as_deref(), b.blend_weight.as_deref()];
    let motion = superpoint_motion(constants.motion != 0, constants.blend, words);
    for row in 0..rows as usize {
        let centre = moved_centre(&frame, b.mean, motion, first_row as usize + row);
        for e in 0..NONRIGID_ENCODING {
            let value = encoded(centre, frame.time, e);
            set_f32(b.encoding, row * NONRIGID_ENCODING + e, value);
        }
    }
}

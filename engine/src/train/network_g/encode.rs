//! Kernel `encode_gaussians`: the input of network G, kept for the backward pass.

use super::Inputs;
use crate::error::Result;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::frame::Frame;
use crate::render::nonrigid_network::{RigidMotion, encoded, moved_centre};
use crate::render::twin::{push, set_f32, spec, struct_at};
use crate::scene::network::NONRIGID_ENCODING;

crate::gpu_struct! {
    /// Push constants of [`ENCODE_GAUSSIANS`].
    pub struct EncodePush {
        /// Gaussian of the first row.
        pub first_row: u32,
        /// Rows to write.
        pub rows: u32,
    }
}

/// Gaussians per workgroup.
const GROUP_GAUSSIANS: u32 = 64;

/// Positional encoding of the moved centres and the time, `[rows, 84]`.
pub static ENCODE_GAUSSIANS: Kernel = Kernel {
    name: "encode_gaussians",
    doc: "positional encoding of moved centres and time",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "MOTION"],
    push: EncodePush::FIELDS,
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Read, Element::U32),
        Binding::new("pose", Access::Read, Element::F32),
        Binding::new("encoding", Access::Write, Element::F32),
    ],
    twin: encode_twin,
    // Slopes of 2^9 times a few ulps of the moved centre.
    tolerance: Tolerance { absolute: 1e-3, relative: 0.0, flips: 0.0 },
    bytes: |work| work.get("gaussians") * 4 * (4 + NONRIGID_ENCODING as u64),
    spirv: include_bytes!("../../../../spirv_cache/encode_gaussians.spv"),
};

/// Records it.
pub(super) fn record(r: &mut Recorder, from: &Inputs<'_>, push: EncodePush, encoding: &Slice) -> Result<()> {
    let buffers = [from.frame, from.mean, from.superpoint_of_gaussian, from.pose, encoding].map(Clone::clone);
    let groups = Groups::Direct(push.rows.div_ceil(GROUP_GAUSSIANS).into());
    r.dispatch_untyped(&ENCODE_GAUSSIANS, &[u32::from(from.moving)], bytemuck::bytes_of(&push), &buffers, groups)
}

fn encode_twin(call: &mut TwinCall<'_>) {
    let EncodePush { first_row, rows } = push(call);
    let frame: Frame = struct_at(&call.buffers[0], 0);
    let motion = spec(call, 1);
    for row in 0..rows as usize {
        let rigid = RigidMotion { superpoint_of_gaussian: &call.buffers[2], pose: &call.buffers[3] };
        let rigid = (motion != 0).then_some(rigid);
        let centre = moved_centre(&frame, &call.buffers[1], rigid, first_row as usize + row);
        for e in 0..NONRIGID_ENCODING {
            let value = encoded(centre, frame.background[3], e);
            set_f32(&mut call.buffers[4], row * NONRIGID_ENCODING + e, value);
        }
    }
}

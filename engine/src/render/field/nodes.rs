//! Kernel `field_nodes`: what a field says of control nodes, summed for the Gaussians that follow them.

use glam::Vec3;

use crate::error::Result;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::frame::Frame;
use crate::render::quaternion;
use crate::render::twin::{f32_at, push, set_f32, spec, struct_at, vec4_at};

crate::gpu_struct! {
    /// Push constants of [`FIELD_NODES`].
    pub struct NodesPush {
        /// M.
        pub nodes: u32,
        /// K.
        pub neighbors: u32,
        /// Columns of `head_output`.
        pub outputs: u32,
    }
}

const THREADS: u32 = 256;

/// Offsets of Gaussians that follow control nodes.
pub static FIELD_NODES: Kernel = Kernel {
    name: "field_nodes",
    doc: "deformation field: Gaussians follow control nodes",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE", "TURN"],
    push: NodesPush::FIELDS,
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("head_output", Access::Read, Element::F32),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("rotation", Access::Read, Element::F32),
        Binding::new("node_position", Access::Read, Element::F32),
        Binding::new("node_neighbor", Access::Read, Element::U32),
        Binding::new("node_weight", Access::Read, Element::F32),
        Binding::new("node_share", Access::Read, Element::F32),
        Binding::new("nonrigid_offset", Access::Write, Element::F32),
    ],
    twin: nodes_twin,
    // Sums of a few products, in another order when fused.
    tolerance: Tolerance { absolute: 1e-5, relative: 2e-5, flips: 0.0 },
    bytes: |work| work.get("gaussians") * 4 * (3 + 4 + 1 + 10 + 2 * work.get("neighbors")),
    spirv: include_bytes!("../../../../spirv_cache/field_nodes.spv"),
};

/// Records it.
pub(super) fn record(
    r: &mut Recorder,
    gaussians: u32,
    turn: bool,
    push: NodesPush,
    buffers: &[Slice; 9],
) -> Result<()> {
    let groups = Groups::Direct(gaussians.div_ceil(THREADS).into());
    r.dispatch_untyped(&FIELD_NODES, &[u32::from(turn)], bytemuck::bytes_of(&push), buffers, groups)
}

fn nodes_twin(call: &mut TwinCall<'_>) {
    let p: NodesPush = push(call);
    let frame: Frame = struct_at(&call.buffers[0], 0);
    let turn = spec(call, 1) == 1;
    let (n, k, m) = (frame.gaussians as usize, p.neighbors as usize, p.nodes as usize);
    for g in 0..n {
        let x = Vec3::from_array([0, 1, 2].map(|axis| f32_at(&call.buffers[2], axis * n + g)));
        let mut sum = [0.0_f32; 10];
        for e in g * k..(g + 1) * k {
            let node = (call.buffers[5][e] as usize).min(m - 1);
            let weight = f32_at(&call.buffers[6], e);
            let output = |i: usize| f32_at(&call.buffers[1], node * p.outputs as usize + i);
            let mut own: [f32; 10] = std::array::from_fn(output);
            if turn {
                let q = [output(10) + 1.0, output(11), output(12), output(13)];
                let length = q.iter().map(|c| c * c).sum::<f32>().sqrt();
                let place = Vec3::from_array([0, 1, 2].map(|axis| f32_at(&call.buffers[4], axis * m + node)));
                let around = quaternion::displacement(q.map(|c| c / length), (x - place).to_array());
                (0..3).for_each(|i| own[i] += around[i]);
            }
            sum.iter_mut().zip(own).for_each(|(s, v)| *s += weight * v);
        }
        let share = f32_at(&call.buffers[7], g);
        let length = vec4_at(&call.buffers[3], g).iter().map(|c| c * c).sum::<f32>().sqrt();
        for (i, v) in sum.into_iter().enumerate() {
            let factor = if (3..7).contains(&i) { share / length } else { share };
            set_f32(&mut call.buffers[8], i * n + g, factor * v);
        }
    }
}

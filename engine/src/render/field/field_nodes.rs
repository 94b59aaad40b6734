//! Kernel `field_nodes`: what a field says of control nodes, summed for the Gaussians that follow them.

use glam::Vec3;

use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::frame::Frame;
use crate::render::quaternion;
use crate::render::twin::{f32_at, set_f32, struct_at, vec4_at};

crate::gpu_struct! {
    /// Push constants of [`FIELD_NODES`].
    pub struct FieldNodesPush {
        /// M.
        pub nodes: u32,
        /// K.
        pub neighbors: u32,
        /// Columns of `head_output`.
        pub outputs: u32,
    }
}

const THREADS: u32 = 256;

crate::gpu_constants! {
    /// Specialisation constants of [`FIELD_NODES`].
    pub struct FieldNodesConstants {
        /// 1: nodes turn what is around them.
        turn,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`FIELD_NODES`].
    pub struct FieldNodesBuffers {
        frame: Read Struct(Frame),
        /// `[M, outputs]`
        head_output: Read F32,
        /// `[3][N]`, world units.
        mean: Read F32,
        /// `[N][4]` w, x, y, z, of any length > 0.
        rotation: Read F32,
        /// `[3][M]`, world units.
        node_position: Read F32,
        /// `[N, K]`
        node_neighbor: Read U32,
        /// `[N, K]`
        node_weight: Read F32,
        /// `[N]`
        node_share: Read F32,
        /// `[10][N]`
        nonrigid_offset: Write F32,
    }
}

crate::kernel! {
    /// Offsets of Gaussians that follow control nodes.
    pub static FIELD_NODES: FieldNodes = {
        name: "field_nodes",
        doc: "deformation field: Gaussians follow control nodes",
        local_size: THREADS,
        constants: FieldNodesConstants,
        push: FieldNodesPush,
        buffers: FieldNodesBuffers,
        twin: field_nodes_twin,
        // Sums of a few products, in another order when fused.
        tolerance: Tolerance { absolute: 1e-5, relative: 2e-5, flips: 0.0 },
        bytes: |work| work.get("gaussians") * 4 * (3 + 4 + 1 + 10 + 2 * work.get("neighbors")),
    }
}

/// Records it.
pub(super) fn record(
    r: &mut Recorder,
    gaussians: u32,
    turn: bool,
    push: FieldNodesPush,
    buffers: FieldNodesBuffers<Slice>,
) -> Result<()> {
    let groups = Groups::Direct(gaussians.div_ceil(THREADS).into());
    r.dispatch(&FIELD_NODES, FieldNodesConstants { turn: turn.into() }, push, buffers, groups)
}

fn field_nodes_twin(call: Call<'_, FieldNodes>) {
    let Call { constants, push: p, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let turn = constants.turn == 1;
    let (n, k, m) = (frame.gaussians as usize, p.neighbors as usize, p.nodes as usize);
    for g in 0..n {
        let x = Vec3::from_array([0, 1, 2].map(|axis| f32_at(b.mean, axis * n + g)));
        let mut sum = [0.0_f32; 10];
        for e in g * k..(g + 1) * k {
            let node = (b.node_neighbor[e] as usize).min(m - 1);
            let weight = f32_at(b.node_weight, e);
            let output = |i: usize| f32_at(b.head_output, node * p.outputs as usize + i);
            let mut own: [f32; 10] = std::array::from_fn(output);
            if turn {
                let q = [output(10) + 1.0, output(11), output(12), output(13)];
                let length = q.iter().map(|c| c * c).sum::<f32>().sqrt();
                let place = Vec3::from_array([0, 1, 2].map(|axis| f32_at(b.node_position, axis * m + node)));
                let around = quaternion::displacement(q.map(|c| c / length), (x - place).to_array());
                (0..3).for_each(|i| own[i] += around[i]);
            }
            sum.iter_mut().zip(own).for_each(|(s, v)| *s += weight * v);
        }
        let share = f32_at(b.node_share, g);
        let length = vec4_at(b.rotation, g).iter().map(|c| c * c).sum::<f32>().sqrt();
        for (i, v) in sum.into_iter().enumerate() {
            let factor = if (3..7).contains(&i) { share / length } else { share };
            set_f32(b.nonrigid_offset, i * n + g, factor * v);
        }
    }
}

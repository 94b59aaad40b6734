//! Kernel `network_backward`: gradients before the ReLU of all hidden layers of network F, for blocks of rows.

use super::HEADS;
use super::layers::{NetworkConstants, NetworkPush, THREADS, layers};
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Tolerance, Workload};
use crate::render::twin::{f32_at, set_f32};

crate::gpu_buffers! {
    /// Buffers of [`NETWORK_BACKWARD`].
    pub struct NetworkBackwardBuffers {
        /// `[rows, 8]`: gradient of the heads' outputs.
        pose_gradient: Read F32,
        /// Of each layer, the heads last: W `[outputs, inputs]`, b `[outputs]`, padding to 64 floats.
        parameter: Read F32,
        /// After the ReLU, of each hidden layer `[rows, width]`, `layer_stride` apart.
        hidden_output: Read F32,
        /// Gradient before the ReLU, laid out likewise.
        hidden_gradient: Write F32,
    }
}

crate::kernel! {
    /// dZᵢ = (dZᵢ₊₁ Wᵢ₊₁) ⊙ \[Hᵢ > 0\] down from the heads, H being the outputs of [`super::network_forward`]. Dispatch
    /// [`NetworkConstants::groups`] workgroups.
    pub static NETWORK_BACKWARD: NetworkBackward = {
        name: "network_backward",
        doc: "network F in training: gradients of poses to those before each ReLU",
        local_size: THREADS,
        constants: NetworkConstants,
        push: NetworkPush,
        buffers: NetworkBackwardBuffers,
        twin: network_backward_twin,
        // As forward.
        tolerance: Tolerance { absolute: 2e-5, relative: 2e-5, flips: 0.0 },
        bytes: network_backward_bytes,
    }
}

/// The weights once, each gradient and output once.
fn network_backward_bytes(work: &Workload) -> u64 {
    let columns = u64::from(HEADS) + 2 * work.get("network_hidden");
    work.get("network_bytes") + 4 * work.get("rows") * columns
}

fn network_backward_twin(call: Call<'_, NetworkBackward>) {
    let reached = call.group_count() * call.constants.rows;
    let Call { constants, push: p, buffers: b, .. } = call;
    let (layers, width) = (layers(constants), constants.width as usize);
    for row in 0..p.rows.min(reached) as usize {
        let heads = HEADS as usize;
        let mut above: Vec<f32> = (0..heads).map(|o| f32_at(b.pose_gradient, row * heads + o)).collect();
        for (below, layer) in layers[1..].iter().enumerate().rev() {
            let inputs = layer.shape.inputs() as usize;
            let at = below * p.layer_stride as usize + row * width;
            let neuron = |i: usize| {
                let weight = |o: usize| f64::from(f32_at(b.parameter, layer.first + o * inputs + inputs - width + i));
                let sum: f64 = above.iter().enumerate().map(|(o, g)| weight(o) * f64::from(*g)).sum();
                if f32_at(b.hidden_output, at + i) > 0.0 { sum as f32 } else { 0.0 }
            };
            above = (0..width).map(neuron).collect();
            above.iter().enumerate().for_each(|(i, g)| set_f32(b.hidden_gradient, at + i, *g));
        }
    }
}

//! Kernel `network_forward`: all layers of network F for blocks of rows, with the hidden layers' outputs kept.

use super::HEADS;
use super::layers::{NetworkConstants, NetworkPush, THREADS, layers};
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Tolerance, Workload};
use crate::render::twin::{f32_at, set_f32};
use crate::scene::network::{ENCODING_WIDTH, relu};

crate::gpu_buffers! {
    /// Buffers of [`NETWORK_FORWARD`].
    pub struct NetworkForwardBuffers {
        /// `[rows, 76]`.
        encoding: Read F32,
        /// Of each layer, the heads last: W `[outputs, inputs]`, b `[outputs]`, padding to 64 floats.
        parameter: Read F32,
        /// After the ReLU, of each hidden layer `[rows, width]`, `layer_stride` apart.
        hidden_output: Write F32,
        /// `[rows, 8]`: r, 0, τ, 0; radians and world units.
        pose: Write F32,
    }
}

crate::kernel! {
    /// Poses of all superpoints from their encodings. Dispatch [`NetworkConstants::groups`] workgroups.
    pub static NETWORK_FORWARD: NetworkForward = {
        name: "network_forward",
        doc: "network F in training: encodings to outputs of hidden layers and poses",
        local_size: THREADS,
        constants: NetworkConstants,
        push: NetworkPush,
        buffers: NetworkForwardBuffers,
        twin: network_forward_twin,
        // Sums of up to 332 products, fused or not, in another order than the twin's, layer upon layer.
        tolerance: Tolerance { absolute: 2e-5, relative: 2e-5, flips: 0.0 },
        bytes: network_forward_bytes,
    }
}

/// The weights once, each encoding, output and pose once.
fn network_forward_bytes(work: &Workload) -> u64 {
    let columns = ENCODING_WIDTH as u64 + work.get("network_hidden") + u64::from(HEADS);
    work.get("network_bytes") + 4 * work.get("rows") * columns
}

fn network_forward_twin(call: Call<'_, NetworkForward>) {
    let reached = call.group_count() * call.constants.rows;
    let Call { constants, push: p, buffers: b, .. } = call;
    let layers = layers(constants);
    for row in 0..p.rows.min(reached) as usize {
        let encoding: Vec<f32> = (0..ENCODING_WIDTH).map(|e| f32_at(b.encoding, row * ENCODING_WIDTH + e)).collect();
        let mut below = Vec::new();
        for (i, layer) in layers.iter().enumerate() {
            let input = match (i, layer.shape.inputs_1) {
                (0, _) => encoding.clone(),
                (_, 0) => below,
                _ => [encoding.clone(), below].concat(),
            };
            let (inputs, outputs) = (input.len(), layer.shape.outputs as usize);
            let neuron = |o: usize| {
                let weight = |k: usize| f64::from(f32_at(b.parameter, layer.first + o * inputs + k));
                let sum: f64 = input.iter().enumerate().map(|(k, x)| weight(k) * f64::from(*x)).sum();
                sum + f64::from(f32_at(b.parameter, layer.first + outputs * inputs + o))
            };
            let hidden = i + 1 < layers.len();
            below = (0..outputs).map(|o| if hidden { relu(neuron(o)) } else { neuron(o) } as f32).collect();
            let (words, at) = if hidden {
                (&mut *b.hidden_output, i * p.layer_stride as usize + row * outputs)
            } else {
                (&mut *b.pose, row * outputs)
            };
            below.iter().enumerate().for_each(|(o, y)| set_f32(words, at + o, *y));
        }
    }
}

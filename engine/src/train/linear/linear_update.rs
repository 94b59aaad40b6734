//! Kernel `linear_update`: sum of the slices, then Adam, and a running mean of the weights.

use super::THREADS;
use crate::gpu::interface::Call;
use crate::render::limits::COUNT_FAILED;
use crate::render::linear_forward::SUMS;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::step::Step;
use crate::train::{adam, status};

/// Weights that a thread takes, in one load.
pub(super) const WEIGHTS_PER_THREAD: u32 = 4;

crate::gpu_struct! {
    /// Push constants of [`LINEAR_UPDATE`].
    pub struct LinearUpdatePush {
        /// Weights and biases.
        pub weights: u32,
        /// Slices to add.
        pub slices: u32,
        /// Floats from one slice to the next, a multiple of 4.
        pub slice_stride: u32,
        /// Number of the first weight within the network, for reports.
        pub first_index: u32,
        /// How far the mean goes towards the weights, 0 to 1.
        pub mean_rate: f32,
    }
}

crate::gpu_constants! {
    /// Specialisation constants of [`LINEAR_UPDATE`].
    pub struct LinearUpdateConstants {
        /// An [`super::Output`].
        output,
        /// A [`super::Network`].
        network,
        /// 1: a mean follows the weights.
        mean,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LINEAR_UPDATE`].
    pub struct LinearUpdateBuffers {
        /// Learning rates and Adam's corrections.
        step: Read Struct(Step),
        /// Nothing changes when the frame failed.
        counters: Read U32,
        /// `[slices, slice_stride]`.
        slice_gradient: Read F32,
        /// `[weights]`, padded to a multiple of 4; and so the moments and the gradient.
        parameter: Update F32,
        moment_1: Update F32,
        moment_2: Update F32,
        /// The sums, also those of the padding; absent when Adam takes them.
        gradient: optional Write F32,
        /// `[weights]` running mean of the weights, padded likewise; absent when none is kept.
        mean: optional Update F32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// Sum of the slices, then Adam, then the mean. Dispatch ceil(weights / 1024) workgroups.
    pub static LINEAR_UPDATE: LinearUpdate = {
        name: "linear_update",
        doc: "dense layer: sum of the gradient's slices, Adam, mean of the weights",
        local_size: THREADS,
        constants: LinearUpdateConstants,
        push: LinearUpdatePush,
        buffers: LinearUpdateBuffers,
        twin: linear_update_twin,
        tolerance: SUMS,
        bytes: |work| 4 * work.get("weights") * (work.get("slices") + 6 + 2 * work.get("mean")),
    }
}

fn linear_update_twin(call: Call<'_, LinearUpdate>) {
    let Call { constants, push: p, buffers: mut b, .. } = call;
    if b.counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    // Sums and means are also kept of the padding.
    for at in 0..p.weights.next_multiple_of(4) {
        let sum = (0..p.slices)
            .fold(0.0, |sum, slice| sum + f32_at(b.slice_gradient, (slice * p.slice_stride + at) as usize));
        if let (0, Some(gradient)) = (constants.output, &mut b.gradient) {
            set_f32(gradient, at as usize, sum);
        }
        if constants.output != 0 && at < p.weights {
            update_weight(&mut b, constants.network, at, p.first_index + at, sum);
        }
        if let (1.., 1, Some(mean)) = (constants.output, constants.mean, &mut b.mean) {
            let (at, before) = (at as usize, f32_at(mean, at as usize));
            set_f32(mean, at, before + p.mean_rate * (f32_at(b.parameter, at) - before));
        }
    }
}

/// Twin of `glsl/lib/network_update.glsl`.
fn update_weight(b: &mut LinearUpdateBuffers<&mut [u32]>, network: u32, at: u32, index: u32, gradient: f32) {
    let step: Step = struct_at(b.step, 0);
    let at = at as usize;
    let (rate, bias, group) = match network {
        0 => (step.rate_network_f, step.bias_network_f, status::NETWORK_F),
        _ => (step.rate_network_g, step.bias_network_g, status::NETWORK_G),
    };
    let mut moments = [f32_at(b.moment_1, at), f32_at(b.moment_2, at)];
    let value = adam::update(&step, f32_at(b.parameter, at), gradient, &mut moments, rate, bias);
    if [gradient, value, moments[0], moments[1]].iter().all(|v| v.is_finite()) {
        set_f32(b.parameter, at, value);
        set_f32(b.moment_1, at, moments[0]);
        set_f32(b.moment_2, at, moments[1]);
    } else {
        status::report(b.status, group, index);
    }
}

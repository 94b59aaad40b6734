//! Kernel `linear_backward_input`: dX = (dZ W) ⊙ \[X > 0\].

use super::{LinearConstants, Stage, THREADS};
use crate::gpu::interface::Call;
use crate::render::linear_forward::{SUMS, product_bytes};
use crate::render::twin::{f32_at, set_f32};

crate::gpu_struct! {
    /// Push constants of [`LINEAR_BACKWARD_INPUT`].
    pub struct LinearBackwardInputPush {
        /// Rows of all matrices but the weights.
        pub rows: u32,
        /// Columns of the output gradient.
        pub outputs: u32,
        /// Columns of the input gradient.
        pub inputs: u32,
        /// Columns of the weights.
        pub weight_stride: u32,
        /// First column of the weights that belongs to this input.
        pub first_input: u32,
    }
}

impl LinearBackwardInputPush {
    /// How it runs on a device of this stage.
    pub fn stage(&self, stage: Stage) -> (Stage, bool) {
        stage.for_strides(&[self.outputs, self.inputs, self.weight_stride, self.first_input])
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LINEAR_BACKWARD_INPUT`].
    pub struct LinearBackwardInputBuffers {
        /// `[rows, outputs]`.
        output_gradient: Read F32,
        /// `[outputs, weight_stride]` weights.
        parameter: Read F32,
        /// `[rows, inputs]`.
        layer_input: Read F32,
        /// `[rows, inputs]`.
        input_gradient: Write F32,
    }
}

crate::kernel! {
    /// dX = (dZ W) ⊙ \[X > 0\]. Dispatch [`super::product_groups`] workgroups.
    pub static LINEAR_BACKWARD_INPUT: LinearBackwardInput = {
        name: "linear_backward_input",
        doc: "dense layer: gradient before the ReLU of the layer below",
        local_size: THREADS,
        constants: LinearConstants,
        push: LinearBackwardInputPush,
        buffers: LinearBackwardInputBuffers,
        twin: linear_backward_input_twin,
        tolerance: SUMS,
        bytes: product_bytes,
    }
}

fn linear_backward_input_twin(call: Call<'_, LinearBackwardInput>) {
    let Call { push: p, buffers: b, .. } = call;
    for row in 0..p.rows {
        for i in 0..p.inputs {
            let product = |o| {
                f64::from(f32_at(b.output_gradient, (row * p.outputs + o) as usize))
                    * f64::from(f32_at(b.parameter, (o * p.weight_stride + p.first_input + i) as usize))
            };
            let at = (row * p.inputs + i) as usize;
            let value =
                if f32_at(b.layer_input, at) > 0.0 { (0..p.outputs).map(product).sum::<f64>() as f32 } else { 0.0 };
            set_f32(b.input_gradient, at, value);
        }
    }
}

//! Kernel `linear_backward_weight`: dW = dZᵀ [X₀, X₁], db = Σ dZ.

use super::{LinearConstants, Stage, THREADS};
use crate::gpu::interface::Call;
use crate::render::linear_forward::{SUMS, concatenated, product_bytes};
use crate::render::twin::{f32_at, set_f32};

crate::gpu_struct! {
    /// Push constants of [`LINEAR_BACKWARD_WEIGHT`].
    pub struct LinearBackwardWeightPush {
        /// Rows of the output gradient and of the inputs.
        pub rows: u32,
        /// Columns of the output gradient.
        pub outputs: u32,
        /// Columns of the first input, which starts the binding.
        pub inputs_0: u32,
        /// Columns of the second input.
        pub inputs_1: u32,
        /// Where the second input starts in the binding, in floats.
        pub input_1_at: u32,
        /// Rows that one slice sums.
        pub rows_per_slice: u32,
        /// Slice of the gradient buffer that the first slice goes to.
        pub first_slice: u32,
        /// Floats from one slice of the gradient buffer to the next.
        pub slice_stride: u32,
    }
}

impl LinearBackwardWeightPush {
    /// How it runs on a device of this stage.
    pub fn stage(&self, stage: Stage) -> (Stage, bool) {
        stage.for_strides(&[self.outputs, self.inputs_0, self.inputs_1, self.input_1_at, self.slice_stride])
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LINEAR_BACKWARD_WEIGHT`].
    pub struct LinearBackwardWeightBuffers {
        /// `[rows, outputs]`.
        output_gradient: Read F32,
        /// `[rows, inputs_0]`, and from float `input_1_at` on `[rows, inputs_1]`.
        layer_input: Read F32,
        /// `[slices, slice_stride]`: weights `[outputs, inputs_0 + inputs_1]`, then bias `[outputs]`.
        gradient: Write F32,
    }
}

crate::kernel! {
    /// dW = dZᵀ [X₀, X₁], db = Σ dZ. Dispatch [`super::product_groups`] workgroups.
    pub static LINEAR_BACKWARD_WEIGHT: LinearBackwardWeight = {
        name: "linear_backward_weight",
        doc: "dense layer: gradient of weights and bias, per slice of rows",
        local_size: THREADS,
        constants: LinearConstants,
        push: LinearBackwardWeightPush,
        buffers: LinearBackwardWeightBuffers,
        twin: linear_backward_weight_twin,
        tolerance: SUMS,
        bytes: product_bytes,
    }
}

fn linear_backward_weight_twin(call: Call<'_, LinearBackwardWeight>) {
    let Call { push: p, buffers: b, .. } = call;
    let inputs = p.inputs_0 + p.inputs_1;
    for slice in 0..p.rows.div_ceil(p.rows_per_slice) {
        let first = slice * p.rows_per_slice;
        let rows = || first..(first + p.rows_per_slice).min(p.rows);
        let start = (p.first_slice + slice) * p.slice_stride;
        for o in 0..p.outputs {
            let upstream = |row: u32| f64::from(f32_at(b.output_gradient, (row * p.outputs + o) as usize));
            for i in 0..inputs {
                let product =
                    |row| upstream(row) * concatenated(b.layer_input, [p.inputs_0, p.inputs_1], p.input_1_at, row, i);
                let sum = rows().map(product).sum::<f64>();
                set_f32(b.gradient, (start + o * inputs + i) as usize, sum as f32);
            }
            let bias = rows().map(upstream).sum::<f64>();
            set_f32(b.gradient, (start + p.outputs * inputs + o) as usize, bias as f32);
        }
    }
}

//! Kernel `linear_forward`: Y = act([X₀, X₁] Wᵀ + b) on row-major matrices of f32, as a tiled product
//! (`glsl/lib/matrix_product.glsl`). Deformation fields run on it, and networks F and G in training.

use super::twin::{f32_at, set_f32};
use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Tolerance, Workload};
use crate::gpu::product::{PRODUCT_THREADS, Stage, product_groups};
use crate::gpu::{Groups, Recorder, Slice};
use crate::scene::network::relu;

crate::gpu_struct! {
    /// Push constants of [`LINEAR_FORWARD`].
    pub struct ForwardPush {
        /// Rows of input and output.
        pub rows: u32,
        /// Columns of the output.
        pub outputs: u32,
        /// Columns of the first input, which starts the binding.
        pub inputs_0: u32,
        /// Columns of the second input.
        pub inputs_1: u32,
        /// Where the second input starts in the binding, in floats.
        pub input_1_at: u32,
    }
}

impl ForwardPush {
    /// How it runs on a device of this stage.
    pub fn stage(&self, stage: Stage) -> (Stage, bool) {
        stage.for_strides(&[self.outputs, self.inputs_0, self.inputs_1, self.input_1_at])
    }
}

/// Sums of up to 512 products of numbers around 1, fused or not, in another order than the twin's.
pub(crate) const SUMS: Tolerance = Tolerance { absolute: 1e-4, relative: 2e-5, flips: 0.0 };

/// Bytes of the three matrices of a product (`rows`, `inputs`, `outputs` of the workload), once each.
pub(crate) fn product_bytes(work: &Workload) -> u64 {
    let [rows, inputs, outputs] = ["rows", "inputs", "outputs"].map(|name| work.get(name));
    4 * (rows * inputs + inputs * outputs + rows * outputs)
}

crate::gpu_constants! {
    /// Specialisation constants of [`LINEAR_FORWARD`].
    pub struct LinearForwardConstants {
        /// How tiles reach the lanes ([`Stage`]).
        stage,
        /// 1: the act is a ReLU, else none.
        relu,
        /// 1: strides and offsets are multiples of 4, so that four neighbours are one load.
        vectors,
        /// Of a workgroup ([`Stage::threads`]).
        threads,
    }
}

impl LinearForwardConstants {
    /// Of a product that [`ForwardPush::stage`] judged, for a subgroup size.
    pub fn new((stage, vectors): (Stage, bool), relu: bool, lanes: u32) -> Self {
        Self { stage: stage as u32, relu: relu.into(), vectors: vectors.into(), threads: stage.threads(lanes) }
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LINEAR_FORWARD`].
    pub struct LinearForwardBuffers {
        /// X₀ `[rows, inputs_0]` from float 0 on, X₁ `[rows, inputs_1]` from float `input_1_at` on.
        layer_input: Read F32,
        /// W `[outputs, inputs]`, then b `[outputs]`.
        parameter: Read F32,
        /// Y `[rows, outputs]`.
        layer_output: Write F32,
    }
}

crate::kernel! {
    /// Y = act([X₀, X₁] Wᵀ + b).
    pub static LINEAR_FORWARD: LinearForward = {
        name: "linear_forward",
        doc: "dense layer: product of rows and weights, bias, ReLU",
        local_size: PRODUCT_THREADS,
        constants: LinearForwardConstants,
        push: ForwardPush,
        buffers: LinearForwardBuffers,
        twin: linear_forward_twin,
        tolerance: SUMS,
        bytes: product_bytes,
    }
}

/// Records it.
pub(crate) fn record(
    r: &mut Recorder,
    stage: Stage,
    push: ForwardPush,
    relu: bool,
    buffers: LinearForwardBuffers<Slice>,
) -> Result<()> {
    let (stage, vectors) = push.stage(stage);
    let lanes = r.subgroup_size_of(&LINEAR_FORWARD);
    let groups = Groups::Direct(product_groups(stage, lanes, push.rows, push.outputs, 1));
    let constants = LinearForwardConstants::new((stage, vectors), relu, lanes);
    r.dispatch(&LINEAR_FORWARD, constants, push, buffers, groups)
}

/// Element (row, k) of two matrices side by side, the second from float `input_1_at` on.
pub(crate) fn concatenated(words: &[u32], inputs: [u32; 2], input_1_at: u32, row: u32, k: u32) -> f64 {
    let [i0, i1] = inputs;
    let at = if k < i0 { row * i0 + k } else { input_1_at + row * i1 + k - i0 };
    f32_at(words, at as usize).into()
}

fn linear_forward_twin(call: Call<'_, LinearForward>) {
    let Call { constants, push: p, buffers: b, .. } = call;
    let inputs = p.inputs_0 + p.inputs_1;
    for row in 0..p.rows {
        for o in 0..p.outputs {
            let product = |k| {
                f64::from(f32_at(b.parameter, (o * inputs + k) as usize))
                    * concatenated(b.layer_input, [p.inputs_0, p.inputs_1], p.input_1_at, row, k)
            };
            let bias = f64::from(f32_at(b.parameter, (p.outputs * inputs + o) as usize));
            let y = (0..inputs).map(product).sum::<f64>() + bias;
            let y = if constants.relu == 1 { relu(y) } else { y };
            set_f32(b.layer_output, (row * p.outputs + o) as usize, y as f32);
        }
    }
}

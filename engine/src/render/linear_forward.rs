//! Kernel `linear_forward`: Y = act([X₀, X₁] Wᵀ + b) on row-major matrices of f32, as a tiled product
//! (`glsl/lib/matrix_product.glsl`). Deformation fields run on it, and networks F and G in training.

use super::twin::{f32_at, push, set_f32, spec};
use crate::error::Result;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall, Workload};
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

/// Sums of up to 512 products of numbers around 1, fused or not, in another order than the twin's.
pub(crate) const SUMS: Tolerance = Tolerance { absolute: 1e-4, relative: 2e-5, flips: 0.0 };

/// Bytes of the three matrices of a product (`rows`, `inputs`, `outputs` of the workload), once each.
pub(crate) fn product_bytes(work: &Workload) -> u64 {
    let [rows, inputs, outputs] = ["rows", "inputs", "outputs"].map(|name| work.get(name));
    4 * (rows * inputs + inputs * outputs + rows * outputs)
}

/// Y = act([X₀, X₁] Wᵀ + b).
pub static LINEAR_FORWARD: Kernel = Kernel {
    name: "linear_forward",
    doc: "dense layer: product of rows and weights, bias, ReLU",
    local_size: PRODUCT_THREADS,
    spec: &["SUBGROUP_SIZE", "STAGE", "RELU"],
    push: ForwardPush::FIELDS,
    bindings: &[
        Binding::new("layer_input", Access::Read, Element::F32),
        Binding::new("parameter", Access::Read, Element::F32),
        Binding::new("layer_output", Access::Write, Element::F32),
    ],
    twin: forward_twin,
    tolerance: SUMS,
    bytes: product_bytes,
    spirv: include_bytes!("../../../spirv_cache/linear_forward.spv"),
};

/// Records it; `buffers` in binding order.
pub(crate) fn record(
    r: &mut Recorder,
    stage: Stage,
    push: ForwardPush,
    relu: bool,
    buffers: &[Slice; 3],
) -> Result<()> {
    let groups = Groups::Direct(product_groups(stage, r.subgroup_size_of(&LINEAR_FORWARD), push.rows, push.outputs, 1));
    r.dispatch_untyped(&LINEAR_FORWARD, &[stage as u32, u32::from(relu)], bytemuck::bytes_of(&push), buffers, groups)
}

/// Element (row, k) of two matrices side by side, the second from float `input_1_at` on.
pub(crate) fn concatenated(words: &[u32], inputs: [u32; 2], input_1_at: u32, row: u32, k: u32) -> f64 {
    let [i0, i1] = inputs;
    let at = if k < i0 { row * i0 + k } else { input_1_at + row * i1 + k - i0 };
    f32_at(words, at as usize).into()
}

fn forward_twin(call: &mut TwinCall<'_>) {
    let p: ForwardPush = push(call);
    let with_relu = spec(call, 2) == 1;
    let inputs = p.inputs_0 + p.inputs_1;
    let [input, parameter, output] = call.buffers else { return };
    for row in 0..p.rows {
        for o in 0..p.outputs {
            let product = |k| {
                f64::from(f32_at(parameter, (o * inputs + k) as usize))
                    * concatenated(input, [p.inputs_0, p.inputs_1], p.input_1_at, row, k)
            };
            let bias = f64::from(f32_at(parameter, (p.outputs * inputs + o) as usize));
            let y = (0..inputs).map(product).sum::<f64>() + bias;
            set_f32(output, (row * p.outputs + o) as usize, if with_relu { relu(y) } else { y } as f32);
        }
    }
}

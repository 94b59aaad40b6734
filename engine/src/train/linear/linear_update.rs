//! Declarations of the kernels of dense layers.

use super::twins;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance};
use crate::gpu::product::PRODUCT_THREADS;
use crate::render::linear_forward::{SUMS, product_bytes};
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of [`LINEAR_BACKWARD_INPUT`].
    pub struct InputPush {
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

crate::gpu_struct! {
    /// Push constants of [`LINEAR_BACKWARD_WEIGHT`].
    pub struct WeightPush {
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

crate::gpu_struct! {
    /// Push constants of [`LINEAR_UPDATE`].
    pub struct UpdatePush {
        /// Weights and biases.
        pub weights: u32,
        /// Slices to add.
        pub slices: u32,
        /// Floats from one slice to the next.
        pub slice_stride: u32,
        /// Number of the first weight within the network, for reports.
        pub first_index: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of [`GATHER_GRADIENT`].
    pub struct GatherPush {
        /// Rows to write.
        pub rows: u32,
        /// Element of each plane that becomes the first row.
        pub first_row: u32,
        /// Floats from one plane to the next.
        pub plane_stride: u32,
        /// Columns of network G that get a gradient: 10, or 7 without scale.
        pub columns: u32,
    }
}

/// Threads per workgroup.
pub(super) const THREADS: u32 = PRODUCT_THREADS;
/// Weights that a thread of `linear_update` takes, so that it loads the step's constants once for all of them.
pub(super) const WEIGHTS_PER_THREAD: u32 = 4;
/// dX = (dZ W) ⊙ \[X > 0\].
pub static LINEAR_BACKWARD_INPUT: Kernel = Kernel {
    name: "linear_backward_input",
    doc: "dense layer: gradient before the ReLU of the layer below",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE", "STAGE"],
    push: InputPush::FIELDS,
    bindings: &[
        Binding::new("output_gradient", Access::Read, Element::F32),
        Binding::new("parameter", Access::Read, Element::F32),
        Binding::new("layer_input", Access::Read, Element::F32),
        Binding::new("input_gradient", Access::Write, Element::F32),
    ],
    twin: twins::backward_input,
    tolerance: SUMS,
    bytes: product_bytes,
    spirv: include_bytes!("../../../../spirv_cache/linear_backward_input.spv"),
};

/// dW = dZᵀ [X₀, X₁], db = Σ dZ.
pub static LINEAR_BACKWARD_WEIGHT: Kernel = Kernel {
    name: "linear_backward_weight",
    doc: "dense layer: gradient of weights and bias, per slice of rows",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE", "STAGE"],
    push: WeightPush::FIELDS,
    bindings: &[
        Binding::new("output_gradient", Access::Read, Element::F32),
        Binding::new("layer_input", Access::Read, Element::F32),
        Binding::new("gradient", Access::Write, Element::F32),
    ],
    twin: twins::backward_weight,
    tolerance: SUMS,
    bytes: product_bytes,
    spirv: include_bytes!("../../../../spirv_cache/linear_backward_weight.spv"),
};

/// Sum of the slices, then Adam.
pub static LINEAR_UPDATE: Kernel = Kernel {
    name: "linear_update",
    doc: "dense layer: sum of the gradient's slices, Adam",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE", "OUTPUT", "NETWORK"],
    push: UpdatePush::FIELDS,
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("slice_gradient", Access::Read, Element::F32),
        Binding::new("parameter", Access::Update, Element::F32),
        Binding::new("moment_1", Access::Update, Element::F32),
        Binding::new("moment_2", Access::Update, Element::F32),
        Binding::new("gradient", Access::Write, Element::F32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: twins::update,
    tolerance: SUMS,
    bytes: |work| 4 * work.get("weights") * (work.get("slices") + 6),
    spirv: include_bytes!("../../../../spirv_cache/linear_update.spv"),
};

/// Planes to rows.
pub static GATHER_GRADIENT: Kernel = Kernel {
    name: "gather_gradient",
    doc: "gradient planes of a network's heads to rows, checked",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE", "NETWORK"],
    push: GatherPush::FIELDS,
    bindings: &[
        Binding::new("plane", Access::Read, Element::F32),
        Binding::new("row_gradient", Access::Write, Element::F32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: twins::gather,
    tolerance: Tolerance::EXACT,
    bytes: |work| 4 * work.get("rows") * (work.get("planes") + work.get("planes").next_multiple_of(4)),
    spirv: include_bytes!("../../../../spirv_cache/gather_gradient.spv"),
};

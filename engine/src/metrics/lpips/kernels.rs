//! Declarations of the kernels of LPIPS.

use super::twins;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance};
use crate::gpu::product::PRODUCT_THREADS;

crate::gpu_struct! {
    /// Push constants of [`LPIPS_CONV`].
    pub struct ConvPush {
        /// Channels of the input.
        pub inputs: u32,
        /// Channels of the output.
        pub outputs: u32,
        /// Pixels of the input.
        pub in_width: u32,
        /// Rows of the picture that the input is a band of.
        pub in_height: u32,
        /// First of the rows that the input holds.
        pub in_first_row: u32,
        /// Rows that the input holds.
        pub in_rows: u32,
        /// Pixels of the output.
        pub out_width: u32,
        /// First of the rows that are written.
        pub out_first_row: u32,
        /// Rows that are written, all that the output holds.
        pub out_rows: u32,
        /// First of the channels that are written.
        pub first_output: u32,
        /// Channels that are written.
        pub output_count: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of [`LPIPS_POOL`].
    pub struct PoolPush {
        /// Channels.
        pub channels: u32,
        /// Pixels of the input.
        pub in_width: u32,
        /// Rows that the input holds, from row 2·`out_first_row` on.
        pub in_rows: u32,
        /// Pixels of the output.
        pub out_width: u32,
        /// Rows that the output holds.
        pub out_height: u32,
        /// First of the rows that are written.
        pub out_first_row: u32,
        /// Rows that are written.
        pub out_rows: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of [`LPIPS_DIFFERENCE`].
    pub struct DifferencePush {
        /// Channels.
        pub channels: u32,
        /// Pixels.
        pub pixels: u32,
    }
}

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&LPIPS_CONV, &LPIPS_POOL, &LPIPS_DIFFERENCE];

/// Threads per workgroup.
pub(super) const THREADS: u32 = PRODUCT_THREADS;

/// Sums of up to 4608 products of numbers around 1, fused or not, in another order than the twin's.
const SUMS: Tolerance = Tolerance { absolute: 1e-4, relative: 2e-5, flips: 0.0 };

/// Convolution, bias, ReLU.
pub static LPIPS_CONV: Kernel = Kernel {
    name: "lpips_conv",
    doc: "LPIPS: convolution as a tiled product, bias, ReLU",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE", "STAGE", "KERNEL", "STRIDE", "PAD"],
    push: ConvPush::FIELDS,
    bindings: &[
        Binding::new("feature_input", Access::Read, Element::F32),
        Binding::new("parameter", Access::Read, Element::F32),
        Binding::new("feature_output", Access::Write, Element::F32),
    ],
    twin: twins::conv,
    tolerance: SUMS,
    bytes: |work| 4 * (work.get("inputs") + work.get("parameters") + work.get("outputs")),
    spirv: include_bytes!("../../../../spirv_cache/lpips_conv.spv"),
};

/// Max pool.
pub static LPIPS_POOL: Kernel = Kernel {
    name: "lpips_pool",
    doc: "LPIPS: max pool of stride 2",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE", "KERNEL"],
    push: PoolPush::FIELDS,
    bindings: &[
        Binding::new("feature_input", Access::Read, Element::F32),
        Binding::new("feature_output", Access::Write, Element::F32),
    ],
    twin: twins::pool,
    tolerance: Tolerance::EXACT,
    bytes: |work| 4 * (work.get("inputs") + work.get("outputs")),
    spirv: include_bytes!("../../../../spirv_cache/lpips_pool.spv"),
};

/// Normalised, weighted difference.
pub static LPIPS_DIFFERENCE: Kernel = Kernel {
    name: "lpips_difference",
    doc: "LPIPS: weighted squared difference of normalised features",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE"],
    push: DifferencePush::FIELDS,
    bindings: &[
        Binding::new("first", Access::Read, Element::F32),
        Binding::new("second", Access::Read, Element::F32),
        Binding::new("head", Access::Read, Element::F32),
        Binding::new("distance_of_pixel", Access::Write, Element::F32),
    ],
    twin: twins::difference,
    tolerance: SUMS,
    bytes: |work| 4 * (2 * work.get("inputs") + work.get("pixels")),
    spirv: include_bytes!("../../../../spirv_cache/lpips_difference.spv"),
};

//! Kernels `density_decide` and `density_histogram`.

use super::{
    ACTION_CLONE, ACTION_KEEP, ACTION_PRUNE, ACTION_SPLIT, DENSITY_BLOCK, SPLIT_LOG_SCALE, mean_gradient,
    rows_of_action,
};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::twin::{self, f32_at};

crate::gpu_struct! {
    /// Push constants of `density_decide`.
    pub struct DecidePush {
        /// N.
        pub gaussians: u32,
        /// Mean gradient norm from which a Gaussian grows.
        pub gradient_threshold: f32,
        /// Logit of the smallest opacity that stays.
        pub min_opacity_logit: f32,
        /// ln(`percent_dense`·extent): up to it clone, above it split.
        pub dense_log_scale: f32,
        /// ln(0.1·extent), or infinity.
        pub world_log_scale: f32,
        /// Largest screen radius, px, or infinity.
        pub max_screen_radius: f32,
        /// Growth is granted to gradient bits above this,
        pub accept_key: u32,
        /// and, at equality, to indices up to this.
        pub accept_index: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of `density_histogram`.
    pub struct HistogramPush {
        /// N.
        pub gaussians: u32,
        /// 0: keys are gradient bits; 1: inverted indices of those whose gradient bits are `tie_key`.
        pub by_index: u32,
        /// See `by_index`.
        pub tie_key: u32,
        /// Bits of the key that are known.
        pub prefix_mask: u32,
        /// Their values.
        pub prefix: u32,
        /// Lowest bit of the digit.
        pub shift: u32,
    }
}

/// Words of `totals`: pruned, kept, cloned, split, refused by the budget (those are also kept or pruned), zeros.
pub const TOTAL_WORDS: usize = 8;
/// Words of `histogram`.
pub(super) const HISTOGRAM_WORDS: u32 = 2048;

/// Dispatch ceil(N / 256) workgroups; `totals` must be zero.
pub static DENSITY_DECIDE: Kernel = Kernel {
    name: "density_decide",
    doc: "prune, keep, clone or split each Gaussian; counts, and new rows per block of 256",
    local_size: DENSITY_BLOCK,
    spec: &["SUBGROUP_SIZE"],
    push: DecidePush::FIELDS,
    bindings: &[
        Binding::new("log_scale", Access::Read, Element::F32),
        Binding::new("opacity_logit", Access::Read, Element::F32),
        Binding::new("density", Access::Read, Element::F32),
        Binding::new("max_radius", Access::Read, Element::F32),
        Binding::new("action", Access::Write, Element::U32),
        Binding::new("row_block", Access::Write, Element::U32),
        Binding::new("totals", Access::Atomic, Element::U32),
    ],
    twin: decide_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 32 * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/density_decide.spv"),
};

/// Action of Gaussian `i`, and whether the budget refused its growth.
fn decide(push: &DecidePush, [log_scale, opacity_logit, density, max_radius]: [&[u32]; 4], i: usize) -> (u32, bool) {
    let n = push.gaussians as usize;
    let scale = [0, 1, 2].map(|axis| f32_at(log_scale, axis * n + i));
    let visible = f32_at(opacity_logit, i) >= push.min_opacity_logit;
    if !visible || !scale.iter().all(|s| s.is_finite()) {
        return (ACTION_PRUNE, false);
    }
    let largest = scale[0].max(scale[1]).max(scale[2]);
    let g = mean_gradient(f32_at(density, i), f32_at(density, n + i));
    let grows = g >= push.gradient_threshold;
    if grows {
        let clone = largest <= push.dense_log_scale;
        if largest - (if clone { 0.0 } else { SPLIT_LOG_SCALE }) > push.world_log_scale {
            return (ACTION_PRUNE, false);
        }
        let key = g.to_bits();
        if key > push.accept_key || (key == push.accept_key && i as u32 <= push.accept_index) {
            return (if clone { ACTION_CLONE } else { ACTION_SPLIT }, false);
        }
    }
    let too_large = largest > push.world_log_scale || (!grows && f32_at(max_radius, i) > push.max_screen_radius);
    (if too_large { ACTION_PRUNE } else { ACTION_KEEP }, grows)
}

fn decide_twin(call: &mut TwinCall<'_>) {
    let push: DecidePush = twin::push(call);
    let [log_scale, opacity_logit, density, max_radius, action, row_block, totals] = call.buffers else { return };
    let blocks = push.gaussians.div_ceil(DENSITY_BLOCK) as usize;
    row_block[..blocks].fill(0);
    for i in 0..push.gaussians as usize {
        let (what, refused) = decide(&push, [log_scale, opacity_logit, density, max_radius], i);
        action[i] = what;
        row_block[i / DENSITY_BLOCK as usize] += rows_of_action(what);
        totals[what as usize] += 1;
        totals[4] += u32::from(refused);
    }
}

/// Dispatch ceil(N / 256) workgroups after `density_decide`; `histogram` `uint[2048]` must be zero.
pub static DENSITY_HISTOGRAM: Kernel = Kernel {
    name: "density_histogram",
    doc: "counts one 11-bit digit of the growing Gaussians' keys, to select those within the budget",
    local_size: DENSITY_BLOCK,
    spec: &["SUBGROUP_SIZE"],
    push: HistogramPush::FIELDS,
    bindings: &[
        Binding::new("density", Access::Read, Element::F32),
        Binding::new("action", Access::Read, Element::U32),
        Binding::new("histogram", Access::Atomic, Element::U32),
    ],
    twin: histogram_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 12 * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/density_histogram.spv"),
};

fn histogram_twin(call: &mut TwinCall<'_>) {
    let push: HistogramPush = twin::push(call);
    let [density, action, histogram] = call.buffers else { return };
    let n = push.gaussians as usize;
    for i in (0..n).filter(|&i| action[i] >= ACTION_CLONE) {
        let bits = mean_gradient(f32_at(density, i), f32_at(density, n + i)).to_bits();
        let key = if push.by_index == 1 { !(i as u32) } else { bits };
        let candidate = push.by_index == 0 || bits == push.tie_key;
        if candidate && key & push.prefix_mask == push.prefix {
            histogram[((key >> push.shift) & (HISTOGRAM_WORDS - 1)) as usize] += 1;
        }
    }
}

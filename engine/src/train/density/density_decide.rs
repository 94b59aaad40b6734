//! Kernel `density_decide`: what becomes of each Gaussian.

use super::{
    ACTION_CLONE, ACTION_KEEP, ACTION_PRUNE, ACTION_SPLIT, DENSITY_BLOCK, SPLIT_LOG_SCALE, mean_gradient,
    rows_of_action,
};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::twin::f32_at;

/// Words of `totals`: pruned, kept, cloned, split, refused by the budget (those are also kept or pruned), zeros.
pub const TOTAL_WORDS: usize = 8;

crate::gpu_struct! {
    /// Push constants of `density_decide`.
    pub struct DensityDecidePush {
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

crate::gpu_buffers! {
    /// Buffers of [`DENSITY_DECIDE`].
    pub struct DensityDecideBuffers {
        /// `float[3][N]`.
        log_scale: Read F32,
        /// `float[N]`.
        opacity_logit: Read F32,
        /// `float[2][N]`: sum of screen-gradient norms, number of views.
        density: Read F32,
        /// `float[N]`, px.
        max_radius: Read F32,
        /// `uint[N]`: [`ACTION_PRUNE`] and so on.
        action: Write U32,
        /// New rows of each block of 256 Gaussians.
        row_block: Write U32,
        /// [`TOTAL_WORDS`] words; zero before.
        totals: Atomic U32,
    }
}

crate::kernel! {
    /// Dispatch ceil(N / 256) workgroups.
    pub static DENSITY_DECIDE: DensityDecide = {
        name: "density_decide",
        doc: "prune, keep, clone or split each Gaussian; counts, and new rows per block of 256",
        local_size: DENSITY_BLOCK,
        constants: (),
        push: DensityDecidePush,
        buffers: DensityDecideBuffers,
        twin: density_decide_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 32 * w.get("gaussians"),
    }
}

/// Action of Gaussian `i`, and whether the budget refused its growth.
fn decide(push: &DensityDecidePush, b: &DensityDecideBuffers<&mut [u32]>, i: usize) -> (u32, bool) {
    let n = push.gaussians as usize;
    let scale = [0, 1, 2].map(|axis| f32_at(b.log_scale, axis * n + i));
    let visible = f32_at(b.opacity_logit, i) >= push.min_opacity_logit;
    if !visible || !scale.iter().all(|s| s.is_finite()) {
        return (ACTION_PRUNE, false);
    }
    let largest = scale[0].max(scale[1]).max(scale[2]);
    let g = mean_gradient(f32_at(b.density, i), f32_at(b.density, n + i));
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
    let too_large = largest > push.world_log_scale || (!grows && f32_at(b.max_radius, i) > push.max_screen_radius);
    (if too_large { ACTION_PRUNE } else { ACTION_KEEP }, grows)
}

fn density_decide_twin(call: Call<'_, DensityDecide>) {
    let Call { push, buffers: b, .. } = call;
    let blocks = push.gaussians.div_ceil(DENSITY_BLOCK) as usize;
    b.row_block[..blocks].fill(0);
    for i in 0..push.gaussians as usize {
        let (what, refused) = decide(&push, &b, i);
        b.action[i] = what;
        b.row_block[i / DENSITY_BLOCK as usize] += rows_of_action(what);
        b.totals[what as usize] += 1;
        b.totals[4] += u32::from(refused);
    }
}

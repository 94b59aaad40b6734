//! What a training step is, as the kernels see it: the Rust mirror of `glsl/lib/step.glsl`.

crate::gpu_struct! {
    /// Counts, learning rates, Adam's corrections and loss weights of one step; written by the host before it.
    pub struct Step {
        /// Gaussians, superpoints, association slots per Gaussian, iteration.
        pub counts: [u32; 4],
        /// Learning rates: mean, log_scale, rotation, opacity_logit.
        pub rate_0: [f32; 4],
        /// Learning rates: sh_0, sh_1..3, network F, association logits.
        pub rate_1: [f32; 4],
        /// Learning rate of network G; the rest is 0.
        pub rate_2: [f32; 4],
        /// β₁, β₂, ε, 0.
        pub adam: [f32; 4],
        /// 1/(1−β₁ᵗ), 1/√(1−β₂ᵗ) of the Gaussians, then of network F.
        pub bias_0: [f32; 4],
        /// The same of the association, then of network G.
        pub bias_1: [f32; 4],
        /// λ of D-SSIM, then of the property losses: position, rotation, translation.
        pub weights: [f32; 4],
        /// Time given to the networks (with noise), exact time, whether density statistics are kept (1 or 0), 0.
        pub time: [f32; 4],
    }
}

/// Adam's corrections at update `t` (from 1): 1/(1−β₁ᵗ), 1/√(1−β₂ᵗ).
pub fn bias_corrections(beta_1: f64, beta_2: f64, t: u64) -> [f32; 2] {
    let t = t.max(1) as f64;
    [(1.0 / (1.0 - beta_1.powf(t))) as f32, (1.0 / (1.0 - beta_2.powf(t)).sqrt()) as f32]
}

//! What a training step is, as the kernels see it: the Rust mirror of `glsl/lib/step.glsl`.

use crate::scene::parameter::PARAMETERS;

/// Length of [`Step::rate`]: as many as there are parameters, to a multiple of 8 bytes.
pub(super) const RATES: usize = PARAMETERS.len().next_multiple_of(2);

crate::gpu_struct! {
    /// Counts, learning rates, Adam's corrections and loss weights of one step; written by the host before it. Corrections:
    /// 1/(1−β₁ᵗ), 1/√(1−β₂ᵗ).
    pub struct Step {
        /// Corrections of the Gaussians.
        pub bias_gaussians: [f32; 2],
        /// Corrections of network F.
        pub bias_network_f: [f32; 2],
        /// Corrections of the association.
        pub bias_association: [f32; 2],
        /// Corrections of network G.
        pub bias_network_g: [f32; 2],
        /// Gaussians.
        pub gaussians: u32,
        /// Superpoints.
        pub superpoints: u32,
        /// Association slots per Gaussian.
        pub neighbors: u32,
        /// Number of the step, from 1.
        pub iteration: u32,
        /// Learning rate of network F.
        pub rate_network_f: f32,
        /// Learning rate of the association logits.
        pub rate_association: f32,
        /// Learning rate of network G.
        pub rate_network_g: f32,
        /// λ of D-SSIM.
        pub weight_dssim: f32,
        /// λ of the property loss of positions.
        pub weight_position: f32,
        /// λ of the property loss of rotations.
        pub weight_rotation: f32,
        /// λ of the property loss of translations.
        pub weight_translation: f32,
        /// Time given to the networks, with noise.
        pub time: f32,
        /// Time of the image.
        pub exact_time: f32,
        /// Density statistics: 0 not kept, 1 of gradients by the centre, 2 of absolute ones.
        pub density_statistics: f32,
        /// Adam's decay of the first moment.
        pub beta_1: f32,
        /// Adam's decay of the second moment.
        pub beta_2: f32,
        /// Adam's ε, added to the root of the second moment.
        pub epsilon: f32,
        /// Word of the photos' buffer where this step's begins.
        pub photo: u32,
        /// Learning rates of the Gaussians' [`PARAMETERS`].
        pub rate: [f32; RATES],
        /// The key pose before the image's time.
        pub key_first: u32,
        /// The one after it; the same before the first and after the last one.
        pub key_second: u32,
        /// Weight of the second.
        pub key_weight: f32,
        /// Pixels of a step of key poses.
        pub rate_key: f32,
        /// Share that is left of the terms that hold key poses.
        pub key_fade: f32,
        /// Pixels of the image.
        pub pixels: f32,
        /// Number of the photo.
        pub exposure: u32,
        /// Learning rate of its exposure.
        pub rate_exposure: f32,
    }
}

impl Step {
    /// The usual constants of Adam for Gaussians, 0.9, 0.999, 1e-15 (3D Gaussian Splatting), and zeros.
    pub fn with_usual_adam() -> Self {
        Self { beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, ..Self::default() }
    }

    /// λ of the property losses: position, rotation, translation.
    pub fn property_weights(&self) -> [f32; 3] {
        [self.weight_position, self.weight_rotation, self.weight_translation]
    }
}

/// Adam's corrections at update `t` (from 1): 1/(1−β₁ᵗ), 1/√(1−β₂ᵗ).
pub fn bias_corrections(beta_1: f64, beta_2: f64, t: u64) -> [f32; 2] {
    let t = t.max(1) as f64;
    [(1.0 / (1.0 - beta_1.powf(t))) as f32, (1.0 / (1.0 - beta_2.powf(t)).sqrt()) as f32]
}

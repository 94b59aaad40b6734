//! Adam (Kingma and Ba 2015): m ← β₁m + (1−β₁)g, v ← β₂v + (1−β₂)g², x ← x − rate·m̂ / (√v̂ + ε), with
//! m̂ = m/(1−β₁ᵗ), v̂ = v/(1−β₂ᵗ). Kernels that know a gradient update its parameter at once.

use super::step::Step;

/// One step on one value; twin of `adam_update` in `glsl/lib/adam.glsl`. Returns the new value, updates the moments.
pub fn update(step: &Step, value: f32, gradient: f32, moments: &mut [f32; 2], rate: f32, bias: [f32; 2]) -> f32 {
    let Step { beta_1, beta_2, epsilon, .. } = *step;
    moments[0] = beta_1 * moments[0] + (1.0 - beta_1) * gradient;
    moments[1] = beta_2 * moments[1] + (1.0 - beta_2) * gradient * gradient;
    value - rate * (moments[0] * bias[0]) / (moments[1].sqrt() * bias[1] + epsilon)
}

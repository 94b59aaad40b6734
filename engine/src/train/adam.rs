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

#[cfg(test)]
mod tests {
    use super::super::step::bias_corrections;
    use super::*;

    /// Two updates against the formula in f64.
    #[test]
    fn updates_follow_the_formula() {
        let step = Step::with_usual_adam();
        for (value, rate) in [(0.7_f32, 1e-3_f32), (-3.0, 5e-2), (1e-4, 1e-5)] {
            let (mut moments, mut found) = ([0.0; 2], value);
            let (mut m, mut v, mut x) = (0.0, 0.0, f64::from(value));
            for (t, gradient) in [(1_u64, 0.02_f32), (2, -0.5)] {
                found = update(&step, found, gradient, &mut moments, rate, bias_corrections(0.9, 0.999, t));
                let g = f64::from(gradient);
                (m, v) = (0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g);
                let (m_hat, v_hat) = (m / (1.0 - 0.9_f64.powi(t as i32)), v / (1.0 - 0.999_f64.powi(t as i32)));
                x -= f64::from(rate) * m_hat / (v_hat.sqrt() + 1e-15);
                let error = (f64::from(found) - x).abs();
                assert!(error <= 1e-5 * f64::from(rate) + 1e-6 * x.abs(), "{value} {rate} {t}: {found} for {x}");
            }
        }
    }
}

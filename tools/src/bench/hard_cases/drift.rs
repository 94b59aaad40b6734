//! Case 17: many frames, and many steps of Adam with short numbers.

use engine::error::Result;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{Random, moving_scene};

use super::case::{Case, Check, Context, Outcome};
use super::repeat::hash_image;
use super::views;

/// Steps of the paper's run.
const STEPS: u32 = 40_000;
/// Parameters of the study.
const PARAMETERS: usize = 64;

pub(super) fn cases() -> Vec<Case> {
    let frames = "One renderer, frame after frame of a moving scene at 32×24; the first frame again at the end.";
    let state = "40,000 steps of Adam on 64 noisy parabolas, state in f32, bf16 and f16 against f64 (study).";
    vec![
        Case::new(17, "many_frames", frames, judge_frames),
        Case::new(17, "adam_state_40k_steps", state, |_| Ok(judge_state())),
    ]
}

fn judge_frames(context: &Context<'_>) -> Result<Outcome> {
    let scene = moving_scene(500, 8, 9, 171, false);
    let mut renderer = Renderer::new(context.gpu, &scene, &RenderOptions::default())?;
    let camera = views::camera(32, 24);
    let before = hash_image(&renderer.render(&camera, 0.25)?);
    let buffers = context.gpu.buffer_count();
    let memory = renderer.memory();
    for i in 0..context.frames {
        renderer.draw(&camera, f64::from(i) * 0.618_034 % 1.0)?;
    }
    let after = hash_image(&renderer.render(&camera, 0.25)?);
    let grown = u64::from(renderer.memory() != memory) + context.gpu.buffer_count().abs_diff(buffers);
    Ok(Outcome {
        truth: format!(
            "{} frames lie between; no state crosses a frame (--frames changes their number)",
            context.frames
        ),
        checks: vec![
            Check::exactly("first frames whose bits changed", usize::from(before != after), 0),
            Check::exactly("buffers or bytes that came or went", grown as usize, 0),
        ],
    })
}

/// Nearest bf16.
fn bf16(x: f64) -> f64 {
    let bits = (x as f32).to_bits();
    f64::from(f32::from_bits((bits + 0x7FFF + (bits >> 16 & 1)) & 0xFFFF_0000))
}

/// Nearest f16, subnormals included.
fn f16(x: f64) -> f64 {
    let size = x.abs();
    if size >= 65_520.0 {
        return f64::INFINITY.copysign(x);
    }
    let exponent = (size.log2().floor() as i32).max(-14);
    let unit = 2.0_f64.powi(exponent - 10);
    (x / unit).round_ties_even() * unit
}

/// The largest distance from the f64 run, in units of the way that parameters travelled.
fn drift(store: fn(f64) -> f64, moments: fn(f64) -> f64) -> f64 {
    let (mut exact, mut test) = (Adam::new(|x| x, |x| x), Adam::new(store, moments));
    for step in 1..=STEPS {
        exact.step(step);
        test.step(step);
    }
    let distances = exact.x.iter().zip(&test.x).map(|(a, b)| (a - b).abs());
    let worst = distances.fold(0.0, |w: f64, d| if d.is_finite() { w.max(d) } else { f64::MAX });
    let way = exact.x.iter().fold(0.0_f64, |w, x| w.max(x.abs()));
    (worst / way).min(f64::MAX)
}

/// Adam on ½·c·(x − target)² with noise on the gradient; the rate falls log-linearly from 1.6e-3 to 1.6e-5.
struct Adam {
    x: Vec<f64>,
    m: Vec<f64>,
    v: Vec<f64>,
    noise: Random,
    store: fn(f64) -> f64,
    moments: fn(f64) -> f64,
}

impl Adam {
    fn new(store: fn(f64) -> f64, moments: fn(f64) -> f64) -> Self {
        let zero = || vec![0.0; PARAMETERS];
        Self { x: zero(), m: zero(), v: zero(), noise: Random::new(17), store, moments }
    }

    fn step(&mut self, step: u32) {
        let (beta_1, beta_2, epsilon) = (0.9_f64, 0.999_f64, 1.0e-15);
        let rate = 1.6e-3 * (-(100.0_f64.ln()) * f64::from(step) / f64::from(STEPS)).exp();
        let bias = [1.0 - beta_1.powi(step as i32), 1.0 - beta_2.powi(step as i32)];
        for i in 0..PARAMETERS {
            let target = if i % 2 == 0 { 1.0 } else { -0.7 };
            // Gradients of images span many decades: so do those of the parabolas.
            let curvature = 10.0_f64.powf(-6.0 * i as f64 / PARAMETERS as f64);
            let gradient = curvature * (self.x[i] - target + 0.3 * self.noise.normal());
            self.m[i] = (self.moments)(beta_1 * self.m[i] + (1.0 - beta_1) * gradient);
            self.v[i] = (self.moments)(beta_2 * self.v[i] + (1.0 - beta_2) * gradient * gradient);
            let change = rate * (self.m[i] / bias[0]) / ((self.v[i] / bias[1]).sqrt() + epsilon);
            self.x[i] = (self.store)(self.x[i] - change);
        }
    }
}

fn judge_state() -> Outcome {
    let f32_ = |x: f64| f64::from(x as f32);
    // A second moment that underflows divides by epsilon; what is shown is capped so that it stays a number.
    let shown = |what: &str, value: f64| Check::shown(what, value.min(1.0e300));
    Outcome {
        truth: "distance of the parameters from an f64 run, in units of the way they travelled".into(),
        checks: vec![
            Check::at_most("f32 parameters and moments (the engine's)", drift(f32_, f32_), 1.0e-3),
            shown("bf16 moments", drift(f32_, bf16)),
            shown("f16 moments", drift(f32_, f16)),
            shown("bf16 parameters", drift(bf16, f32_)),
        ],
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn short_numbers_are_rounded_to_nearest_even() {
        assert_eq!([bf16(1.0), bf16(1.003_906_25), bf16(1.01)], [1.0, 1.0, 1.007_812_5]);
        assert_eq!([f16(1.0), f16(1.000_4), f16(0.1)], [1.0, 1.0, 0.099_975_585_937_5]);
        assert_eq!(
            [f16(65_519.0), f16(-7.0e4), f16(5.0e-8), f16(2.0e-8)],
            [65_504.0, f64::NEG_INFINITY, 5.960_464_477_539_063e-8, 0.0]
        );
        assert_eq!(f16(0.0), 0.0);
    }
}

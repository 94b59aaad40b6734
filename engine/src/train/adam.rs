//! Adam (Kingma and Ba 2015): m ← β₁m + (1−β₁)g, v ← β₂v + (1−β₂)g², x ← x − rate·m̂ / (√v̂ + ε), with
//! m̂ = m/(1−β₁ᵗ), v̂ = v/(1−β₂ᵗ). Kernels that know a gradient update its parameter at once; [`ADAM`] is for flat arrays.

use super::status;
use super::step::Step;
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Kernel, Tolerance};
use crate::render::limits::COUNT_FAILED;
use crate::render::twin::{f32_at, set_f32, struct_at};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&ADAM.kernel];

crate::gpu_struct! {
    /// Push constants of `adam`.
    pub struct AdamPush {
        /// Elements.
        pub count: u32,
        /// Learning rate: 0–3 of `rate_0`, 4–7 of `rate_1`, 8 of `rate_2`.
        pub rate: u32,
        /// Corrections: 0 Gaussians, 1 network F, 2 association, 3 network G.
        pub bias: u32,
        /// Group of [`status::GROUPS`] under which numbers that are not finite are reported.
        pub group: u32,
    }
}

/// Rate, corrections and report group of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AdamGroup {
    /// Network F.
    NetworkF,
    /// Association logits.
    Association,
    /// Network G.
    NetworkG,
}

impl AdamPush {
    /// Push constants for `count` elements of a group.
    pub fn new(count: u32, group: AdamGroup) -> Self {
        match group {
            AdamGroup::NetworkF => Self { count, rate: 6, bias: 1, group: 5 },
            AdamGroup::Association => Self { count, rate: 7, bias: 2, group: 6 },
            AdamGroup::NetworkG => Self { count, rate: 8, bias: 3, group: 7 },
        }
    }

    /// The learning rate and the corrections that these constants select.
    fn select(&self, step: &Step) -> (f32, [f32; 2]) {
        let rates = [step.rate_0, step.rate_1, step.rate_2];
        let pair = if self.bias < 2 { step.bias_0 } else { step.bias_1 };
        let first = 2 * (self.bias as usize & 1);
        (rates[(self.rate as usize / 4).min(2)][self.rate as usize & 3], [pair[first], pair[first + 1]])
    }
}

crate::gpu_buffers! {
    /// Buffers of [`ADAM`]; the arrays have `count` elements.
    pub struct AdamBuffers {
        step: Read Struct(Step),
        /// Counters of the frame; nothing happens when it failed.
        counters: Read U32,
        gradient: Read F32,
        value: Update F32,
        moment_1: Update F32,
        moment_2: Update F32,
        /// As [`status`] says.
        status: Atomic U32,
    }
}

crate::kernel! {
    /// One step on a flat array. Dispatch ceil(count / 256) workgroups. A gradient, new value or new moment that is not finite
    /// is reported and nothing of that element changes.
    pub static ADAM: Adam = {
        name: "adam",
        doc: "one step of Adam on a flat array",
        local_size: 256,
        constants: (),
        push: AdamPush,
        buffers: AdamBuffers,
        twin: adam_twin,
        tolerance: Tolerance { absolute: 1e-7, relative: 1e-5, flips: 0.0 },
        bytes: |w| 28 * w.get("weights"),
    }
}

fn adam_twin(call: Call<'_, Adam>) {
    let Call { push, buffers: b, .. } = call;
    if b.counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    let step: Step = struct_at(b.step, 0);
    let (rate, bias) = push.select(&step);
    for i in 0..push.count as usize {
        let g = f32_at(b.gradient, i);
        let mut moments = [f32_at(b.moment_1, i), f32_at(b.moment_2, i)];
        let updated = update(&step, f32_at(b.value, i), g, &mut moments, rate, bias);
        if [g, updated, moments[0], moments[1]].iter().all(|x| x.is_finite()) {
            set_f32(b.value, i, updated);
            set_f32(b.moment_1, i, moments[0]);
            set_f32(b.moment_2, i, moments[1]);
        } else {
            status::report(b.status, push.group as usize, i as u32);
        }
    }
}

/// One step on one value; twin of `adam_update` in `glsl/lib/adam.glsl`. Returns the new value, updates the moments.
pub fn update(step: &Step, value: f32, gradient: f32, moments: &mut [f32; 2], rate: f32, bias: [f32; 2]) -> f32 {
    let [beta_1, beta_2, epsilon, _] = step.adam;
    moments[0] = beta_1 * moments[0] + (1.0 - beta_1) * gradient;
    moments[1] = beta_2 * moments[1] + (1.0 - beta_2) * gradient * gradient;
    value - rate * (moments[0] * bias[0]) / (moments[1].sqrt() * bias[1] + epsilon)
}

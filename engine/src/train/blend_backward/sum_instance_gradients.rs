//! Kernel `sum_instance_gradients`: a Gaussian's row from those of its instances.

use super::ROW_WORDS;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::limits::{COUNT_FAILED, COUNT_INSTANCES};
use crate::render::twin::{f32_at, set_f32};

crate::gpu_struct! {
    /// Push constants of `sum_instance_gradients`.
    pub struct SumInstanceGradientsPush {
        /// N.
        pub gaussians: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SUM_INSTANCE_GRADIENTS`].
    pub struct SumInstanceGradientsBuffers {
        /// Counters of the frame; the sums are 0 when it failed.
        counters: Read U32,
        /// `uint[N]`: instances of each Gaussian.
        tile_count: Read U32,
        /// `uint[N]`: its first slot.
        first_slot: Read U32,
        /// `float[12·instances]` by slot.
        instance_gradient: Read F32,
        /// `float[12·N]`.
        splat_gradient: Write F32,
    }
}

crate::kernel! {
    /// Sums of the instances' rows. Dispatch ceil(3 N / 256) workgroups.
    pub static SUM_INSTANCE_GRADIENTS: SumInstanceGradients = {
        name: "sum_instance_gradients",
        doc: "sums the gradient rows of each Gaussian's instances in slot order",
        local_size: 256,
        constants: (),
        push: SumInstanceGradientsPush,
        buffers: SumInstanceGradientsBuffers,
        twin: sum_instance_gradients_twin,
        tolerance: Tolerance { absolute: 1e-5, relative: 1e-5, flips: 0.0 },
        bytes: |w| w.get("instances") * 48 + w.get("gaussians") * (8 + 48),
    }
}

fn sum_instance_gradients_twin(call: Call<'_, SumInstanceGradients>) {
    let words = call.group_count() * 256 * 4;
    let Call { push, buffers: b, .. } = call;
    let instances = b.counters[COUNT_INSTANCES as usize];
    for word in 0..(push.gaussians * ROW_WORDS).min(words) {
        let [gaussian, c] = [word / ROW_WORDS, word % ROW_WORDS];
        let count = if b.counters[COUNT_FAILED as usize] == 0 { b.tile_count[gaussian as usize] } else { 0 };
        let first = if count > 0 { b.first_slot[gaussian as usize].min(instances) } else { 0 };
        let slots = first..first + count.min(instances - first);
        let sum: f64 = slots.map(|slot| f64::from(f32_at(b.instance_gradient, (ROW_WORDS * slot + c) as usize))).sum();
        set_f32(b.splat_gradient, word as usize, sum as f32);
    }
}

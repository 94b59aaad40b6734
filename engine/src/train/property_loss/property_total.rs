//! Kernel `property_total`.

use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::twin;
use crate::train::step::Step;

crate::gpu_buffers! {
    /// Buffers of [`PROPERTY_TOTAL`].
    pub struct PropertyTotalBuffers {
        /// Counts and loss weights.
        step: Read Struct(Step),
        /// `vec4[workgroups]` of `property_residual`.
        loss_partial: Read F32,
        /// `[4]`: mean squares of position, rotation and translation, then the weighted total.
        property_loss: Write F32,
    }
}

crate::kernel! {
    /// The losses of the step. Dispatch one workgroup.
    pub static PROPERTY_TOTAL: PropertyTotal = {
        name: "property_total",
        doc: "adds up the property losses in a fixed order",
        local_size: 256,
        constants: (),
        push: (),
        buffers: PropertyTotalBuffers,
        twin: property_total_twin,
        tolerance: Tolerance { absolute: 0.0, relative: 1e-5, flips: 0.0 },
        bytes: |w| w.get("gaussians") / 16,
    }
}

fn property_total_twin(call: Call<'_, PropertyTotal>) {
    let Call { buffers: b, .. } = call;
    let step: Step = twin::struct_at(b.step, 0);
    let n = step.gaussians;
    let mut total = 0.0;
    for c in 0..3 {
        let sum: f64 = (0..n.div_ceil(256) as usize).map(|g| f64::from(twin::f32_at(b.loss_partial, 4 * g + c))).sum();
        let value = sum as f32 / (3.0 * n as f32);
        total += step.property_weights()[c] * value;
        twin::set_f32(b.property_loss, c, value);
    }
    twin::set_f32(b.property_loss, 3, total);
}

//! Kernel `property_values`: the paper's form.

use super::{moved_properties, planes};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::twin;
use crate::train::step::Step;

crate::gpu_buffers! {
    /// Buffers of [`PROPERTY_VALUES`].
    pub struct PropertyValuesBuffers {
        /// Counts.
        step: Read Struct(Step),
        /// `[3][N]` canonical centres.
        mean: Read F32,
        /// `[N]`.
        superpoint_of_gaussian: Read U32,
        /// `vec4[M][2]`.
        pose: Read F32,
        /// `[N][9]`: position at the step's time, so(3) vector, translation.
        property_value: Write F32,
    }
}

crate::kernel! {
    /// Properties of each Gaussian as rows. Dispatch ceil(N / 256) workgroups.
    pub static PROPERTY_VALUES: PropertyValues = {
        name: "property_values",
        doc: "each Gaussian's position at the step's time, so(3) vector and translation (paper's property losses)",
        local_size: 256,
        constants: (),
        push: (),
        buffers: PropertyValuesBuffers,
        twin: property_values_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-6, flips: 0.0 },
        bytes: |w| 52 * w.get("gaussians"),
    }
}

fn property_values_twin(call: Call<'_, PropertyValues>) {
    let Call { buffers: b, .. } = call;
    let step: Step = twin::struct_at(b.step, 0);
    let n = step.gaussians as usize;
    for i in 0..n {
        let s = b.superpoint_of_gaussian[i].min(step.superpoints - 1) as usize;
        let v = moved_properties(b.pose, s, planes(b.mean, 0, n, i)).value;
        v.as_flattened().iter().enumerate().for_each(|(c, x)| twin::set_f32(b.property_value, 9 * i + c, *x));
    }
}

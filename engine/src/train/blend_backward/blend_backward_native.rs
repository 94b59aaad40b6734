//! Kernel `blend_backward_native`: [`blend_backward`](super) with the device's float atomics.

use super::twin::blend_backward_twin;
use super::{BlendBackwardBuffers, BlendBackwardConstants, TOLERANCE, blend_backward_bytes};
use crate::render::blend::BLEND_THREADS;

crate::kernel! {
    /// `gradient_rows` is `splat_gradient`, `values` are Gaussians.
    pub static BLEND_BACKWARD_NATIVE: BlendBackwardNative = {
        name: "blend_backward_native",
        doc: "blend_backward that adds to the Gaussian's row with the device's float atomics",
        local_size: BLEND_THREADS,
        constants: BlendBackwardConstants,
        push: (),
        buffers: BlendBackwardBuffers,
        twin: |call| blend_backward_twin(call.constants, call.buffers),
        tolerance: TOLERANCE,
        bytes: blend_backward_bytes,
    }
}

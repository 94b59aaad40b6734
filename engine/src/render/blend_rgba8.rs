//! Kernel `blend_rgba8`: [`blend`](super::blend) straight into a host's image of 8-bit levels ([`blend_image`](super::blend_image)).

use super::blend::{BLEND_THREADS, BLEND_TOLERANCE, BlendConstants};
use super::blend_image::{BlendImageBuffers, BlendImagePush, blend_image_twin};
use super::blend_packed::blend_packed_bytes;
use super::pixel_format::PixelFormat;

crate::kernel! {
    /// Stores 8-bit levels.
    pub static BLEND_RGBA8: BlendRgba8 = {
        name: "blend_rgba8",
        doc: "blend straight into a host's image of 8-bit levels",
        local_size: BLEND_THREADS,
        constants: BlendConstants,
        push: BlendImagePush,
        buffers: BlendImageBuffers,
        image: "picture",
        twin: |call| blend_image_twin(call, PixelFormat::Rgba8),
        tolerance: BLEND_TOLERANCE,
        bytes: blend_packed_bytes,
    }
}

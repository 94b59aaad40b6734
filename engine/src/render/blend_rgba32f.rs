//! Kernel `blend_rgba32f`: [`blend`](super::blend) straight into a host's image of floats ([`blend_image`](super::blend_image)).

use super::blend::{BLEND_THREADS, BLEND_TOLERANCE, BlendConstants};
use super::blend_image::{BlendImageBuffers, BlendImagePush, blend_image_twin};
use super::blend_packed::blend_packed_bytes;
use super::pixel_format::PixelFormat;

crate::kernel! {
    /// Stores the engine's own bits.
    pub static BLEND_RGBA32F: BlendRgba32F = {
        name: "blend_rgba32f",
        doc: "blend straight into a host's image of floats",
        local_size: BLEND_THREADS,
        constants: BlendConstants,
        push: BlendImagePush,
        buffers: BlendImageBuffers,
        image: "picture",
        twin: |call| blend_image_twin(call, PixelFormat::Rgba32F),
        tolerance: BLEND_TOLERANCE,
        bytes: blend_packed_bytes,
    }
}

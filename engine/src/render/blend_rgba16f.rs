//! Kernel `blend_rgba16f`: [`blend`](super::blend) straight into a host's image of half floats ([`blend_image`](super::blend_image)).

use super::blend::{BLEND_THREADS, BLEND_TOLERANCE, BlendConstants};
use super::blend_image::{BlendImageBuffers, BlendImagePush, blend_image_twin};
use super::blend_packed::blend_packed_bytes;
use super::pixel_format::PixelFormat;

crate::kernel! {
    /// Stores half floats. Vulkan lets the device round to nearest or towards zero.
    pub static BLEND_RGBA16F: BlendRgba16F = {
        name: "blend_rgba16f",
        doc: "blend straight into a host's image of half floats",
        local_size: BLEND_THREADS,
        constants: BlendConstants,
        push: BlendImagePush,
        buffers: BlendImageBuffers,
        image: "picture",
        twin: |call| blend_image_twin(call, PixelFormat::Rgba16F),
        tolerance: BLEND_TOLERANCE,
        bytes: blend_packed_bytes,
    }
}

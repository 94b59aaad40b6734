//! `blend` straight into an image of a host's, through a storage view: no copy follows. One kernel per format, because the
//! format is part of a shader that needs no optional feature of the device. All devices can store these three.

use super::blend::{BASE, PixelFormat, blend_into, blend_packed_bytes};
use super::frame::Frame;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, TwinCall};

/// 8-bit levels.
pub static BLEND_RGBA8: Kernel = Kernel {
    name: "blend_rgba8",
    doc: "blend straight into a host's image of 8-bit levels",
    twin: |call| twin(call, PixelFormat::Rgba8),
    spirv: include_bytes!("../../../spirv_cache/blend_rgba8.spv"),
    ..IMAGE_BASE
};

/// Half floats. Vulkan lets the device round to nearest or towards zero.
pub static BLEND_RGBA16F: Kernel = Kernel {
    name: "blend_rgba16f",
    doc: "blend straight into a host's image of half floats",
    twin: |call| twin(call, PixelFormat::Rgba16F),
    spirv: include_bytes!("../../../spirv_cache/blend_rgba16f.spv"),
    ..IMAGE_BASE
};

/// The engine's own bits.
pub static BLEND_RGBA32F: Kernel = Kernel {
    name: "blend_rgba32f",
    doc: "blend straight into a host's image of floats",
    twin: |call| twin(call, PixelFormat::Rgba32F),
    spirv: include_bytes!("../../../spirv_cache/blend_rgba32f.spv"),
    ..IMAGE_BASE
};

/// The kernel that stores a format; `None` where not all devices can.
pub(super) fn kernel_of(format: PixelFormat) -> Option<&'static Kernel> {
    match format {
        PixelFormat::Rgba8 => Some(&BLEND_RGBA8),
        PixelFormat::Bgra8 => None,
        PixelFormat::Rgba16F => Some(&BLEND_RGBA16F),
        PixelFormat::Rgba32F => Some(&BLEND_RGBA32F),
    }
}

const IMAGE_BASE: Kernel = Kernel {
    push: &[("offset_x", 0), ("offset_y", 4)],
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("ranges", Access::Read, Element::U32),
        Binding::new("values", Access::Read, Element::U32),
        Binding::new("splats", Access::Read, Element::F32),
        Binding::new("depth", Access::Write, Element::F32),
        Binding::new("gaussian_of_slot", Access::Read, Element::U32),
        Binding::new("picture", Access::Write, Element::Image),
    ],
    bytes: blend_packed_bytes,
    ..BASE
};

/// The image as tightly packed words, from its first pixel on.
fn twin(call: &mut TwinCall<'_>, format: PixelFormat) {
    call.buffers[4..7].rotate_right(1);
    blend_into(call, format);
    call.buffers[4..7].rotate_left(1);
}

//! Kernel `blend_packed`: [`blend`](super::blend) that stores pixels in the format of a host's image ([`PixelFormat`]). In a frame
//! that goes into such an image this saves writing, reading and converting 16 bytes per pixel.

use super::blend::twin::{Inputs, blend_into};
use super::blend::{BLEND_THREADS, BLEND_TOLERANCE, BlendConstants, blend_bytes};
use super::frame::Frame;
use super::pixel_format::PixelFormat;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Workload;

crate::gpu_constants! {
    /// Specialisation constants of [`BLEND_PACKED`]: those of [`BlendConstants`], and the format.
    pub struct BlendPackedConstants {
        with_depth,
        stage,
        pixels_per_lane,
        with_slots,
        alpha_cut,
        transmittance_stop,
        packing,
        /// A [`PixelFormat`] but the floats, which `blend` stores.
        format,
    }
}

impl BlendPackedConstants {
    /// For pixels of a format.
    pub fn new(constants: BlendConstants, format: PixelFormat) -> Self {
        let BlendConstants { with_depth, stage, pixels_per_lane, with_slots, alpha_cut, transmittance_stop, packing } =
            constants;
        let format = format as u32;
        Self { with_depth, stage, pixels_per_lane, with_slots, alpha_cut, transmittance_stop, packing, format }
    }

    /// Without the format.
    fn blend(self) -> BlendConstants {
        let Self { with_depth, stage, pixels_per_lane, with_slots, alpha_cut, transmittance_stop, packing, .. } = self;
        BlendConstants { with_depth, stage, pixels_per_lane, with_slots, alpha_cut, transmittance_stop, packing }
    }
}

crate::gpu_buffers! {
    /// Buffers of [`BLEND_PACKED`].
    pub struct BlendPackedBuffers {
        frame: Read Struct(Frame),
        ranges: Read U32,
        values: Read U32,
        splats: Read F32,
        /// `[H·W]` of [`PixelFormat::bytes`].
        pixels: Write U32,
        depth: optional Write F32,
        gaussian_of_slot: optional Read U32,
    }
}

crate::kernel! {
    /// `blend` into an 8-bit or half-float picture.
    pub static BLEND_PACKED: BlendPacked = {
        name: "blend_packed",
        doc: "blend, pixels stored in the format of a host's image",
        local_size: BLEND_THREADS,
        constants: BlendPackedConstants,
        push: (),
        buffers: BlendPackedBuffers,
        twin: blend_packed_twin,
        // That of the depth, as for `blend`; a pixel's level may be the next one.
        tolerance: BLEND_TOLERANCE,
        bytes: blend_packed_bytes,
    }
}

/// As `blend`, with the pixels' own size.
pub(super) fn blend_packed_bytes(work: &Workload) -> u64 {
    blend_bytes(work) - work.get("pixels") * 16 + work.get("pixels") * work.get("pixel_bytes")
}

fn blend_packed_twin(call: Call<'_, BlendPacked>) {
    let Call { constants, subgroup_size, buffers: b, .. } = call;
    let format = [PixelFormat::Rgba8, PixelFormat::Bgra8, PixelFormat::Rgba16F][constants.format as usize];
    let input = Inputs {
        subgroup_size,
        constants: constants.blend(),
        frame: b.frame,
        ranges: b.ranges,
        values: b.values,
        splats: b.splats,
        gaussian_of_slot: b.gaussian_of_slot.as_deref(),
    };
    blend_into(&input, format, b.pixels, b.depth);
}

//! `blend` straight into an image of a host's, through a storage view: no copy follows. One kernel per format, because the
//! format is part of a shader that needs no optional feature of the device. All devices can store these three.

use super::blend::BlendConstants;
use super::blend::twin::{Inputs, blend_into};
use super::frame::Frame;
use super::pixel_format::PixelFormat;
use crate::gpu::interface::{Call, Interface};

crate::gpu_struct! {
    /// Push constants of the kernels that store to an image.
    pub struct BlendImagePush {
        /// First pixel of the image that is written.
        pub offset_x: u32,
        /// Its row.
        pub offset_y: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of the kernels that store to an image.
    pub struct BlendImageBuffers {
        frame: Read Struct(Frame),
        ranges: Read U32,
        values: Read U32,
        splats: Read F32,
        depth: optional Write F32,
        gaussian_of_slot: optional Read U32,
    }
}

/// The image as tightly packed words, from its first pixel on.
pub(super) fn blend_image_twin<I>(call: Call<'_, I>, format: PixelFormat)
where
    I: for<'a> Interface<Constants = BlendConstants, Buffers<&'a mut [u32]> = BlendImageBuffers<&'a mut [u32]>>,
{
    let Call { constants, subgroup_size, buffers: b, image, .. } = call;
    let input = Inputs {
        subgroup_size,
        constants,
        frame: b.frame,
        ranges: b.ranges,
        values: b.values,
        splats: b.splats,
        gaussian_of_slot: b.gaussian_of_slot.as_deref(),
    };
    blend_into(&input, format, image, b.depth);
}

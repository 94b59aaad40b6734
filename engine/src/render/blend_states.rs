//! Kernel `blend_states`: [`blend`](super::blend) for training, which also keeps each pixel's state where a [segment](super::segments)
//! of its tile's list begins. Its image is that of `blend` to the bit.

use super::blend::twin::{Inputs, blend_states_twin};
use super::blend::{BLEND_THREADS, BLEND_TOLERANCE, BlendConstants, blend_bytes};
use super::frame::Frame;
use super::segments::Segments;
use crate::gpu::interface::Call;

crate::gpu_constants! {
    /// Specialisation constants of [`BLEND_STATES`].
    pub struct BlendStatesConstants {
        /// A [`Stage`](super::blend::Stage).
        stage,
        /// See [`pixels_per_lane`](super::blend::pixels_per_lane).
        pixels_per_lane,
        /// 1: `values` are slots.
        with_slots,
        /// Most segments of a list: 2 or more.
        segments,
        /// Least splats of a segment.
        least_segment,
    }
}

impl BlendStatesConstants {
    /// Those of `blend`, which draws exactly and no depth, and how lists are cut.
    pub fn new(blend: BlendConstants, segments: Segments) -> Self {
        let BlendConstants { stage, pixels_per_lane, with_slots, .. } = blend;
        Self { stage, pixels_per_lane, with_slots, segments: segments.per_list, least_segment: segments.least }
    }
}

crate::gpu_buffers! {
    /// Buffers of [`BLEND_STATES`].
    pub struct BlendStatesBuffers {
        frame: Read Struct(Frame),
        ranges: Read U32,
        values: Read U32,
        splats: Read F32,
        color: Write F32,
        gaussian_of_slot: optional Read U32,
        /// `vec4[(segments − 1)·H·W]`: colour so far and transmittance (negative once closed) at the beginning of each segment
        /// but the first; nothing where a list has fewer.
        states: Write F32,
    }
}

crate::kernel! {
    /// Blends each tile's splats and keeps the states for `blend_backward`.
    pub static BLEND_STATES: BlendStates = {
        name: "blend_states",
        doc: "blend that keeps each pixel's state where a segment of its tile's list begins, for the backward pass",
        local_size: BLEND_THREADS,
        constants: BlendStatesConstants,
        push: (),
        buffers: BlendStatesBuffers,
        twin: blend_states,
        tolerance: BLEND_TOLERANCE,
        bytes: blend_bytes,
    }
}

fn blend_states(call: Call<'_, BlendStates>) {
    let Call { constants: c, subgroup_size, buffers: b, .. } = call;
    let constants = BlendConstants {
        stage: c.stage,
        pixels_per_lane: c.pixels_per_lane,
        with_slots: c.with_slots,
        ..BlendConstants::default()
    };
    let input = Inputs {
        subgroup_size,
        constants,
        frame: b.frame,
        ranges: b.ranges,
        values: b.values,
        splats: b.splats,
        gaussian_of_slot: b.gaussian_of_slot.as_deref(),
    };
    let segments = Segments { per_list: c.segments, least: c.least_segment };
    blend_states_twin(&input, segments, b.color, b.states);
}

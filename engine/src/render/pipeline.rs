//! The frame as a list of operations: this function reads like the pipeline picture of the crate page.

use crate::error::Result;
use crate::gpu::kernel::Kernel;
use crate::gpu::{Buffer, Commands, Gpu, Groups, Recorder, SLICE_ALIGNMENT, Slice};

use super::blend::{self, BLEND, BLEND_PACKED, PixelFormat};
use super::blend_image;
use super::compact::{
    COMPACT, COMPACT_GAUSSIANS, CompactPush, INDIRECT_DEPTH_SORT, INDIRECT_EMIT, INDIRECT_RANGES, INDIRECT_TILE_SORT,
};
use super::deform_network::DEFORM_NETWORK;
use super::deform_project::{DEFORM_PROJECT, DEFORM_PROJECT_THREADS, DeformProjectPush, MOTION_STATIC, MOTION_TABLE};
use super::limits::{COUNT_INSTANCES, COUNT_VISIBLE};
use super::mean_storage;
use super::nonrigid_network;
use super::quality::Quality;
use super::radix_sort::{SORT_SCATTER, SORT_SPINE, SPINE_GROUPS, rank_by_ballot};
use super::scene_buffers::SceneBuffers;
use super::tiles::{EMIT_TILES, EmitTilesPush, SUM_TILE_COUNTS, SlotBuffers, SumTileCountsPush, TILE_RANGES};
use super::work_buffers::{DEPTH_KEY_BITS, SortBuffers, WorkBuffers};

/// Buffers of one frame in flight.
#[derive(Debug)]
pub(crate) struct FrameBuffers {
    /// `Frame`, written by the host.
    pub(crate) frame: Buffer,
    /// Poses of this frame from the host, when the scene needs them so.
    pub(crate) host_pose: Option<Buffer>,
    /// `[H,W,4]` float.
    pub(crate) color: Buffer,
    /// `[H,W]` float, or a dummy.
    pub(crate) depth: Buffer,
    /// Copy of the counters for the host, looked at after the frame.
    pub(crate) counters: Buffer,
}

/// What else decides the recording.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shape {
    /// Tiles of the image.
    pub(crate) tiles: u32,
    /// The weighted depth is rendered too.
    pub(crate) with_depth: bool,
    /// Tile lists of slots, for the backward pass.
    pub(crate) slots: Option<SlotBuffers>,
    /// What may be given up; exact unless said.
    pub(crate) quality: Quality,
    /// `frame.color` holds pixels of this format; `None`: floats.
    pub(crate) format: Option<PixelFormat>,
    /// Pixels go straight to an image that is given when the sequence is encoded; only with a format that can be stored.
    pub(crate) to_image: bool,
}

/// Records a frame that the host looks at.
pub(super) fn record(
    gpu: &Gpu,
    scene: &SceneBuffers,
    work: &WorkBuffers,
    frame: &FrameBuffers,
    shape: &Shape,
    profile: bool,
) -> Result<Commands> {
    let mut r = gpu.recorder("frame").with_timestamps(profile);
    record_forward(gpu, &mut r, scene, work, frame, shape)?;
    r.copy(&work.counters, frame.counters.slice(0, work.counters.bytes))?;
    r.host_read(&frame.counters);
    r.finish()
}

/// Appends the whole way from the scene to `frame.color`. What moves the scene runs first; where poses
/// come from elsewhere, `scene.deformation.pose` (or `frame.host_pose`) must hold them.
pub(crate) fn record_forward(
    gpu: &Gpu,
    r: &mut Recorder,
    scene: &SceneBuffers,
    work: &WorkBuffers,
    frame: &FrameBuffers,
    shape: &Shape,
) -> Result<()> {
    r.fill(&work.zeroed, 0)?;
    let pose = frame.host_pose.as_ref().unwrap_or(&scene.deformation.pose);
    let offset = scene.deformation.record(gpu, r, scene, &frame.frame, pose)?;
    deform_project(r, scene, work, frame, offset, &shape.quality)?;
    compact(r, scene, work, frame, &shape.quality)?;
    sort(r, "depth", &work.depth, work, COUNT_VISIBLE, INDIRECT_DEPTH_SORT)?;
    emit(r, work, frame, shape)?;
    sort(r, "tile", &work.tile, work, COUNT_INSTANCES, INDIRECT_TILE_SORT)?;
    ranges_and_blend(gpu, r, work, frame, shape)
}

fn deform_project(
    r: &mut Recorder,
    scene: &SceneBuffers,
    work: &WorkBuffers,
    frame: &FrameBuffers,
    nonrigid_offset: Option<Slice>,
    quality: &Quality,
) -> Result<()> {
    let pose = frame.host_pose.as_ref().unwrap_or(&scene.deformation.pose);
    let [sh_0, sh_1, sh_2, sh_3] = &scene.sh;
    let mut buffers = slices(&[
        &frame.frame,
        &scene.mean,
        &scene.log_scale,
        &scene.rotation,
        &scene.opacity_logit,
        &scene.deformation.superpoint_of_gaussian,
        pose,
        sh_0,
        sh_1,
        sh_2,
        sh_3,
        &work.splats,
        &work.tile_count,
    ]);
    let nonrigid = u32::from(nonrigid_offset.is_some());
    // Without non-rigid offsets any buffer that is only read stands in for them.
    let offset = nonrigid_offset.unwrap_or_else(|| Slice::from(&scene.mean));
    buffers.extend([work.visible_block.clone(), work.counters.clone(), offset]);
    let motion = if scene.deformation.moves() { MOTION_TABLE } else { MOTION_STATIC };
    let push = DeformProjectPush { block_capacity: work.block_capacity };
    let groups = u64::from(scene.gaussians.div_ceil(DEFORM_PROJECT_THREADS));
    let spec = [
        scene.sh_degree,
        motion,
        nonrigid,
        quality.alpha_cut_constant(),
        quality.cull_constant(),
        quality.packing_constant(),
        scene.sh_storage.constant(),
        mean_storage::constant(quality.position),
    ];
    r.dispatch(&DEFORM_PROJECT, &spec, bytemuck::bytes_of(&push), &buffers, Groups::Direct(groups))
}

fn compact(
    r: &mut Recorder,
    scene: &SceneBuffers,
    work: &WorkBuffers,
    frame: &FrameBuffers,
    quality: &Quality,
) -> Result<()> {
    let first = &work.depth.plan.digits[0];
    let push = CompactPush { block_capacity: work.block_capacity, digit_bits: first.bits };
    let buffers = [
        Slice::from(&frame.frame),
        Slice::from(&work.tile_count),
        Slice::from(&work.splats),
        work.visible_block.clone(),
        work.counters.clone(),
        Slice::from(&work.indirect),
        Slice::from(&work.depth.keys[0]),
        Slice::from(&work.depth.values[0]),
        work.depth.histograms[0].clone(),
    ];
    // The first workgroup writes the indirect arguments, so one runs even for an empty scene.
    let groups = u64::from(scene.gaussians.div_ceil(COMPACT_GAUSSIANS).max(1));
    let bits = if quality.depth_bits < DEPTH_KEY_BITS { quality.depth_bits } else { 0 };
    let spec = [bits, quality.packing_constant()];
    r.dispatch(&COMPACT, &spec, bytemuck::bytes_of(&push), &buffers, Groups::Direct(groups))
}

/// All passes of a sort whose first histogram the producer of the keys has counted.
fn sort(
    r: &mut Recorder,
    what: &str,
    s: &SortBuffers,
    work: &WorkBuffers,
    count_word: u32,
    indirect_word: u32,
) -> Result<()> {
    for pass in 0..s.plan.digits.len() {
        let (from, to) = (pass % 2, (pass + 1) % 2);
        let histogram = s.histograms[pass].clone();
        if s.plan.prescanned {
            let push = s.plan.spine_push(count_word);
            let buffers = [work.counters.clone(), histogram.clone()];
            let label = format!("sort_spine {what} {pass}");
            let groups = Groups::Direct(SPINE_GROUPS.into());
            r.dispatch_labelled(&label, &SORT_SPINE, &[], bytemuck::bytes_of(&push), &buffers, groups)?;
        }
        // The last pass counts nothing; any other buffer of the right kind stands in for the next histogram.
        let next = s.histograms.get(pass + 1).cloned().unwrap_or_else(|| work.visible_block.clone());
        let buffers = [
            work.counters.clone(),
            histogram,
            Slice::from(&s.keys[from]),
            Slice::from(&s.values[from]),
            Slice::from(&s.keys[to]),
            Slice::from(&s.values[to]),
            next,
        ];
        let push = s.plan.scatter_push(pass, count_word);
        let label = format!("sort_scatter {what} {pass}");
        let groups = Groups::Indirect(work.indirect.clone(), u64::from(indirect_word) * 4);
        r.dispatch_labelled(
            &label,
            &SORT_SCATTER,
            &s.plan.scatter_spec(pass, true, rank_by_ballot(r.subgroup_size_of(&SORT_SCATTER))),
            bytemuck::bytes_of(&push),
            &buffers,
            groups,
        )?;
    }
    Ok(())
}

fn emit(r: &mut Recorder, work: &WorkBuffers, frame: &FrameBuffers, shape: &Shape) -> Result<()> {
    let order = &work.depth.values[work.depth.plan.result_in()];
    let groups = || Groups::Indirect(work.indirect.clone(), u64::from(INDIRECT_EMIT) * 4);
    let push = SumTileCountsPush { block_capacity: work.block_capacity };
    let buffers =
        [work.counters.clone(), Slice::from(&work.tile_count), Slice::from(order), work.instance_block.clone()];
    r.dispatch(&SUM_TILE_COUNTS, &[], bytemuck::bytes_of(&push), &buffers, groups())?;
    let unused = |i: u64| work.unused.slice(i * SLICE_ALIGNMENT, SLICE_ALIGNMENT);
    let (gaussian_of_slot, first_slot) = match &shape.slots {
        Some(slots) => (Slice::from(&slots.gaussian_of_slot), Slice::from(&slots.first_slot)),
        None => (unused(0), unused(1)),
    };
    let push = EmitTilesPush { block_capacity: work.block_capacity, digit_bits: work.tile.plan.digits[0].bits };
    let buffers = [
        Slice::from(&frame.frame),
        work.counters.clone(),
        Slice::from(&work.tile_count),
        Slice::from(order),
        Slice::from(&work.splats),
        work.instance_block.clone(),
        Slice::from(&work.tile.keys[0]),
        Slice::from(&work.tile.values[0]),
        work.tile.histograms[0].clone(),
        gaussian_of_slot,
        first_slot,
    ];
    let q = &shape.quality;
    let spec = [u32::from(shape.slots.is_some()), q.alpha_cut_constant(), q.cull_constant(), q.packing_constant()];
    r.dispatch(&EMIT_TILES, &spec, bytemuck::bytes_of(&push), &buffers, groups())
}

fn ranges_and_blend(
    gpu: &Gpu,
    r: &mut Recorder,
    work: &WorkBuffers,
    frame: &FrameBuffers,
    shape: &Shape,
) -> Result<()> {
    let sorted = work.tile.plan.result_in();
    let buffers =
        [Slice::from(&frame.frame), work.counters.clone(), Slice::from(&work.tile.keys[sorted]), work.ranges.clone()];
    let groups = Groups::Indirect(work.indirect.clone(), u64::from(INDIRECT_RANGES) * 4);
    r.dispatch(&TILE_RANGES, &[], &[], &buffers, groups)?;
    // All kernels that blend have the same.
    let size = gpu.subgroup_size_of(&BLEND);
    let pixels_per_lane = blend::pixels_per_lane(size);
    let stage = blend::Stage::of_device(gpu) as u32;
    let q = &shape.quality;
    let spec = [
        u32::from(shape.with_depth),
        stage,
        pixels_per_lane,
        u32::from(shape.slots.is_some()),
        q.alpha_cut_constant(),
        q.stop_constant(),
        q.packing_constant(),
    ];
    let values = Slice::from(work.tile_values());
    let gaussian_of_slot = shape.slots.as_ref().map_or_else(|| values.clone(), |s| Slice::from(&s.gaussian_of_slot));
    let buffers = [
        Slice::from(&frame.frame),
        work.ranges.clone(),
        values,
        Slice::from(&work.splats),
        Slice::from(&frame.color),
        Slice::from(&frame.depth),
        gaussian_of_slot,
    ];
    let groups = Groups::Direct(blend::groups(shape.tiles, size, pixels_per_lane));
    if let (true, Some(kernel)) = (shape.to_image, shape.format.and_then(blend_image::kernel_of)) {
        let [frame, ranges, values, splats, _, depth, gaussian_of_slot] = buffers;
        let buffers = [frame, ranges, values, splats, depth, gaussian_of_slot];
        return r.dispatch(kernel, &spec, &[], &buffers, groups);
    }
    match shape.format {
        None | Some(PixelFormat::Rgba32F) => r.dispatch(&BLEND, &spec, &[], &buffers, groups),
        Some(format) => {
            let [a, b, c, d, e, f, g] = spec;
            r.dispatch(&BLEND_PACKED, &[a, b, c, d, e, f, g, format as u32], &[], &buffers, groups)
        }
    }
}

fn slices(buffers: &[&Buffer]) -> Vec<Slice> {
    buffers.iter().map(|b| Slice::from(*b)).collect()
}

/// Every kernel of the renderer, for the tests, the docs and the freshness check.
pub static KERNELS: &[&Kernel] = &[
    &DEFORM_NETWORK,
    &nonrigid_network::NONRIGID_NETWORK,
    &super::linear_forward::LINEAR_FORWARD,
    &super::field::FIELD_WAVES,
    &super::field::FIELD_PLANES,
    &super::field::FIELD_OFFSET,
    &super::field::FIELD_NODES,
    &DEFORM_PROJECT,
    &COMPACT,
    &super::radix_sort::SORT_HISTOGRAM,
    &SORT_SPINE,
    &SORT_SCATTER,
    &SUM_TILE_COUNTS,
    &EMIT_TILES,
    &TILE_RANGES,
    &BLEND,
    &BLEND_PACKED,
    &blend_image::BLEND_RGBA8,
    &blend_image::BLEND_RGBA16F,
    &blend_image::BLEND_RGBA32F,
    &super::display::DISPLAY,
    &super::rate::ARITHMETIC_RATE,
];

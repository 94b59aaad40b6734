//! The frame as a list of operations: this function reads like the pipeline picture of the crate page.

use crate::error::Result;
use crate::gpu::kernel::Kernel;
use crate::gpu::schedule::Cost;
use crate::gpu::{Buffer, Commands, Gpu, Groups, Recorder, SLICE_ALIGNMENT, Slice};
use crate::scene::parameter::{LOG_SCALE, MEAN, OPACITY_LOGIT, ROTATION, SH_0};

use super::blend::{self, BLEND, BlendBuffers, BlendConstants};
use super::blend_image::{BlendImageBuffers, BlendImagePush};
use super::blend_packed::{BLEND_PACKED, BlendPackedBuffers, BlendPackedConstants};
use super::blend_rgba8::BLEND_RGBA8;
use super::blend_rgba16f::BLEND_RGBA16F;
use super::blend_rgba32f::BLEND_RGBA32F;
use super::blend_states::{BLEND_STATES, BlendStatesBuffers, BlendStatesConstants};
use super::deform_network::DEFORM_NETWORK;
use super::deform_project::{
    DEFORM_PROJECT, DEFORM_PROJECT_THREADS, DeformProjectBuffers, DeformProjectConstants, DeformProjectPush,
    MOTION_STATIC, MOTION_TABLE,
};
use super::emit_tiles::{EMIT_TILES, EmitTilesBuffers, EmitTilesConstants, EmitTilesPush};
use super::limits::SCAN_BLOCK;
use super::mean_storage;
use super::nonrigid_network::NONRIGID_NETWORK;
use super::pixel_format::PixelFormat;
use super::quality::Quality;
use super::scan_tiles::{SCAN_TILES, ScanTilesBuffers, ScanTilesConstants};
use super::scene_buffers::SceneBuffers;
use super::segments::States;
use super::sort_histogram::SORT_HISTOGRAM;
use super::sort_scatter::SORT_SCATTER;
use super::sort_spine::SORT_SPINE;
use super::sort_tiles::{self, SORT_TILES, SortTilesBuffers};
use super::tiles::SlotBuffers;
use super::work_buffers::WorkBuffers;

/// Buffers of one frame in flight.
#[derive(Debug)]
pub(crate) struct FrameBuffers {
    /// `Frame`, written by the host.
    pub(crate) frame: Buffer,
    /// Poses of this frame from the host, when the scene needs them so.
    pub(crate) host_pose: Option<Buffer>,
    /// `[H,W,4]` float.
    pub(crate) color: Buffer,
    /// `[H,W]` float, of frames with depth.
    pub(crate) depth: Option<Buffer>,
    /// Copy of the counters for the host, looked at after the frame.
    pub(crate) counters: Buffer,
}

impl FrameBuffers {
    /// Bytes of the images.
    pub(crate) fn image_bytes(&self) -> u64 {
        self.color.bytes() + self.depth.as_ref().map_or(0, Buffer::bytes)
    }
}

/// What else decides the recording.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shape {
    /// Tiles of the image.
    pub(crate) tiles: u32,
    /// Pairs that each tile's list has room for; 0: the lists lie one behind the other, as `scan_tiles` says.
    pub(crate) tile_room: u32,
    /// The weighted depth is rendered too.
    pub(crate) with_depth: bool,
    /// Tile lists of slots, for the backward pass.
    pub(crate) slots: Option<SlotBuffers>,
    /// Where the states of the tile lists' segments go, for the backward pass; only with floats and without depth.
    pub(crate) states: Option<States>,
    /// What the counters begin with; zeros without it.
    pub(crate) first_counters: Option<Buffer>,
    /// The frame before left zeros where zeros must be, so that none waits for a fill at its beginning.
    pub(crate) cleared: bool,
    /// What may be given up; exact unless said.
    pub(crate) quality: Quality,
    /// `frame.color` holds pixels of this format; `None`: floats.
    pub(crate) format: Option<PixelFormat>,
    /// Pixels go straight to an image that is given when the sequence is encoded; only with a format that can be stored.
    pub(crate) to_image: bool,
}

/// Records frames that the host looks at, each with buffers of its own. Several are drawn side by side: kernels of one stand beside
/// those of another between the same barriers.
pub(super) fn record(
    gpu: &Gpu,
    scene: &SceneBuffers,
    frames: &[(&WorkBuffers, &FrameBuffers)],
    shape: &Shape,
    profile: bool,
) -> Result<Commands> {
    // No kernel has a choice of level, so that their costs decide nothing.
    let mut r = gpu.recorder("frame").with_timestamps(profile).with_overlap(|_| Cost { time: 1, share: 100 });
    for (work, frame) in frames {
        record_forward(gpu, &mut r, scene, work, frame, shape)?;
        r.copy(&work.counters, frame.counters.slice(0, work.counters.bytes))?;
        if shape.cleared {
            // For the next frame. Blending reads nothing of it: the fill runs beside it.
            r.copy(&work.counters, &work.counted)?;
            r.fill(&work.zeroed, 0)?;
        }
    }
    frames.iter().for_each(|(_, frame)| r.host_read(&frame.counters));
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
    match &shape.first_counters {
        None if shape.cleared => {}
        None => r.fill(&work.zeroed, 0)?,
        Some(first) => {
            // They lie alone at the arena's start.
            r.fill(work.zeroed.slice(SLICE_ALIGNMENT, work.zeroed.bytes() - SLICE_ALIGNMENT), 0)?;
            r.copy(first, &work.counters)?;
        }
    }
    let pose = frame.host_pose.as_ref().unwrap_or(&scene.deformation.pose);
    let offset = scene.deformation.record(gpu, r, scene, &frame.frame, pose)?;
    deform_project(r, scene, work, frame, offset, shape)?;
    if shape.tile_room == 0 {
        scan_tiles(gpu, r, scene, work, frame)?;
        emit_tiles(r, scene, work, frame, shape)?;
    }
    sort_tiles(gpu, r, scene, work, frame, shape)?;
    blend(gpu, r, work, frame, shape)
}

fn deform_project(
    r: &mut Recorder,
    scene: &SceneBuffers,
    work: &WorkBuffers,
    frame: &FrameBuffers,
    nonrigid_offset: Option<Slice>,
    shape: &Shape,
) -> Result<()> {
    let quality = &shape.quality;
    let lists = shape.tile_room != 0;
    let nonrigid = u32::from(nonrigid_offset.is_some());
    let moves = scene.deformation.moves();
    let pose = frame.host_pose.as_ref().unwrap_or(&scene.deformation.pose);
    let buffers = DeformProjectBuffers {
        frame: frame.frame.whole(),
        mean: scene.parameter[MEAN].whole(),
        log_scale: scene.parameter[LOG_SCALE].whole(),
        rotation: scene.parameter[ROTATION].whole(),
        opacity_logit: scene.parameter[OPACITY_LOGIT].whole(),
        superpoint_of_gaussian: scene.deformation.hard_superpoints(),
        pose: moves.then(|| pose.whole()),
        sh_0: scene.parameter[SH_0].whole(),
        sh_1: scene.band(1),
        sh_2: scene.band(2),
        sh_3: scene.band(3),
        splats: work.splats.whole(),
        tile_count: work.tile_count.whole(),
        instance_block: work.instance_block.clone(),
        counters: work.counters.clone(),
        nonrigid_offset,
        optional: scene.optional.as_ref().map(Buffer::whole),
        blend_index: scene.deformation.blend_index(),
        blend_weight: scene.deformation.blend_weight(),
        tile_end: work.tile_counters.clone(),
        pairs: lists.then(|| work.pairs.whole()),
    };
    let push = DeformProjectPush { block_capacity: work.block_capacity };
    let groups = Groups::Direct(scene.gaussians.div_ceil(DEFORM_PROJECT_THREADS).into());
    let constants = DeformProjectConstants {
        sh_degree: scene.sh_degree,
        motion: if moves { MOTION_TABLE } else { MOTION_STATIC },
        nonrigid,
        alpha_cut: quality.alpha_cut_constant(),
        tile_cull: quality.cull_constant(),
        packing: quality.packing_constant(),
        sh_storage: scene.sh_storage.constant(),
        mean_storage: mean_storage::constant(quality.position),
        optional: scene.present.0,
        blend: scene.deformation.blend_slots(),
        antialiased: scene.antialiased.into(),
        lists: lists.into(),
    };
    r.dispatch(&DEFORM_PROJECT, constants, push, buffers, groups)
}

fn scan_tiles(
    gpu: &Gpu,
    r: &mut Recorder,
    scene: &SceneBuffers,
    work: &WorkBuffers,
    frame: &FrameBuffers,
) -> Result<()> {
    let (is_cpu, threads) = sort_workgroup(gpu);
    let long = sort_tiles::long_from(is_cpu, threads, scene.gaussians);
    let buffers = ScanTilesBuffers {
        frame: frame.frame.whole(),
        counters: work.counters.clone(),
        tile_change: work.tile_counters.clone(),
        tile_start: work.tile_start.whole(),
        indirect: (long != 0).then(|| work.indirect.whole()),
    };
    r.dispatch(&SCAN_TILES, ScanTilesConstants { long }, (), buffers, Groups::Direct(1))
}

fn emit_tiles(
    r: &mut Recorder,
    scene: &SceneBuffers,
    work: &WorkBuffers,
    frame: &FrameBuffers,
    shape: &Shape,
) -> Result<()> {
    let slots = shape.slots.as_ref();
    let buffers = EmitTilesBuffers {
        frame: frame.frame.whole(),
        counters: work.counters.clone(),
        tile_count: work.tile_count.whole(),
        splats: work.splats.whole(),
        instance_block: work.instance_block.clone(),
        tile_start: work.tile_start.whole(),
        pairs: work.pairs.whole(),
        tile_end: work.tile_counters.clone(),
        gaussian_of_slot: slots.map(|s| s.gaussian_of_slot.whole()),
        first_slot: slots.map(|s| s.first_slot.whole()),
    };
    let push = EmitTilesPush { block_capacity: work.block_capacity };
    let q = &shape.quality;
    let constants = EmitTilesConstants {
        with_slots: u32::from(slots.is_some()),
        alpha_cut: q.alpha_cut_constant(),
        tile_cull: q.cull_constant(),
        packing: q.packing_constant(),
    };
    let groups = Groups::Direct(scene.gaussians.div_ceil(SCAN_BLOCK).into());
    r.dispatch(&EMIT_TILES, constants, push, buffers, groups)
}

/// Whether the device is a CPU, and the threads of a workgroup that sorts a list.
fn sort_workgroup(gpu: &Gpu) -> (bool, u32) {
    let info = gpu.info();
    (info.is_cpu(), sort_tiles::threads(info, gpu.subgroup_size_of(&SORT_TILES)))
}

fn sort_tiles(
    gpu: &Gpu,
    r: &mut Recorder,
    scene: &SceneBuffers,
    work: &WorkBuffers,
    frame: &FrameBuffers,
    shape: &Shape,
) -> Result<()> {
    let buffers = SortTilesBuffers {
        frame: frame.frame.whole(),
        tile_start: (shape.tile_room == 0).then(|| work.tile_start.whole()),
        pairs: work.pairs.whole(),
        values: work.values.whole(),
        tile_end: work.tile_counters.clone(),
        ranges: work.ranges.whole(),
        counters: work.counters.clone(),
    };
    let (is_cpu, threads) = sort_workgroup(gpu);
    // No Gaussian is twice in a list.
    let most = if shape.tile_room == 0 { scene.gaussians } else { shape.tile_room.min(scene.gaussians) };
    let all = Groups::Direct(shape.tiles.into());
    for constants in sort_tiles::dispatches(is_cpu, threads, most, shape.slots.is_some()) {
        let (label, groups) = match constants.shortest {
            1 => ("sort_tiles", all.clone()),
            _ if shape.tile_room != 0 => ("sort_tiles long", all.clone()),
            _ => ("sort_tiles long", Groups::Indirect(work.indirect.clone(), 0)),
        };
        r.dispatch_labelled(label, &SORT_TILES, constants, (), buffers.clone(), groups)?;
    }
    Ok(())
}

fn blend(gpu: &Gpu, r: &mut Recorder, work: &WorkBuffers, frame: &FrameBuffers, shape: &Shape) -> Result<()> {
    // All kernels that blend have the same.
    let size = gpu.subgroup_size_of(&BLEND);
    let pixels_per_lane = blend::pixels_per_lane(size);
    let groups = Groups::Direct(blend::groups(shape.tiles, size, pixels_per_lane));
    let q = &shape.quality;
    let constants = BlendConstants {
        with_depth: u32::from(shape.with_depth),
        stage: blend::Stage::of_device(gpu) as u32,
        pixels_per_lane,
        with_slots: u32::from(shape.slots.is_some()),
        alpha_cut: q.alpha_cut_constant(),
        transmittance_stop: q.stop_constant(),
        packing: q.packing_constant(),
    };
    let depth = frame.depth.as_ref().filter(|_| shape.with_depth).map(Buffer::whole);
    let (frame, color) = (frame.frame.whole(), frame.color.whole());
    let (ranges, values, splats) = (work.ranges.whole(), work.values.whole(), work.splats.whole());
    let gaussian_of_slot = shape.slots.as_ref().map(|s| s.gaussian_of_slot.whole());
    match shape.format {
        Some(format) if shape.to_image && format.is_storable() => {
            let buffers = BlendImageBuffers { frame, ranges, values, splats, depth, gaussian_of_slot };
            // Image and push constants are given when the sequence is encoded.
            let push = BlendImagePush::default();
            match format {
                PixelFormat::Rgba16F => r.dispatch(&BLEND_RGBA16F, constants, push, buffers, groups),
                PixelFormat::Rgba32F => r.dispatch(&BLEND_RGBA32F, constants, push, buffers, groups),
                _ => r.dispatch(&BLEND_RGBA8, constants, push, buffers, groups),
            }
        }
        None | Some(PixelFormat::Rgba32F) => match &shape.states {
            None => {
                let buffers = BlendBuffers { frame, ranges, values, splats, color, depth, gaussian_of_slot };
                r.dispatch(&BLEND, constants, (), buffers, groups)
            }
            Some(States { segments, buffer }) => {
                let states = buffer.clone();
                let buffers = BlendStatesBuffers { frame, ranges, values, splats, color, gaussian_of_slot, states };
                r.dispatch(&BLEND_STATES, BlendStatesConstants::new(constants, *segments), (), buffers, groups)
            }
        },
        Some(format) => {
            let buffers = BlendPackedBuffers { frame, ranges, values, splats, pixels: color, depth, gaussian_of_slot };
            r.dispatch(&BLEND_PACKED, BlendPackedConstants::new(constants, format), (), buffers, groups)
        }
    }
}

/// Every kernel of the renderer, for the tests, the docs and the freshness check.
pub static KERNELS: &[&Kernel] = &[
    &DEFORM_NETWORK.kernel,
    &NONRIGID_NETWORK.kernel,
    &super::linear_forward::LINEAR_FORWARD.kernel,
    &super::field::field_waves::FIELD_WAVES.kernel,
    &super::field::field_planes::FIELD_PLANES.kernel,
    &super::field::field_offset::FIELD_OFFSET.kernel,
    &super::field::field_nodes::FIELD_NODES.kernel,
    &DEFORM_PROJECT.kernel,
    &SCAN_TILES.kernel,
    &EMIT_TILES.kernel,
    &SORT_TILES.kernel,
    &BLEND.kernel,
    &BLEND_PACKED.kernel,
    &BLEND_RGBA8.kernel,
    &BLEND_RGBA16F.kernel,
    &BLEND_RGBA32F.kernel,
    &BLEND_STATES.kernel,
    &super::display::DISPLAY.kernel,
    &SORT_HISTOGRAM.kernel,
    &SORT_SPINE.kernel,
    &SORT_SCATTER.kernel,
    &super::arithmetic_rate::ARITHMETIC_RATE.kernel,
    &super::copy_rate::COPY_RATE.kernel,
];

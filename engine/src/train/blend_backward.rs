//! Blend backward: from the image's gradient to the splats' gradients.
//!
//! `image_gradient vec4[H·W]` holds dL/d(r, g, b) of each pixel of `color` (background included) and dL/dA with A = 1 − T. The
//! result is one row of [`ROW_WORDS`] floats per Gaussian, `splat_gradient float[12·N]`:
//!
//! | word | sum over the pixels |
//! |---|---|
//! | 0 | h = ∂L/∂ln α = α ∂L/∂α (0 where α is clamped at 0.99: there it does not depend on the splat) |
//! | 1, 2 | h u, h v, with u = l11 dx + l12 dy, v = l22 dy |
//! | 3, 4, 5 | h u², h u v, h v² |
//! | 6, 7, 8 | ∂L/∂(r, g, b) of the splat's colour |
//! | 9 | pixels that it is drawn in |
//! | 10, 11 | \|h u l11\|, \|h (u l12 + v l22)\|: times 2 ln 2 what each pixel moves the centre by, without its sign (Ye et al. 2024, AbsGS) |
//!
//! The forward pass is replayed front to back with its own arithmetic (`glsl/lib/blend.glsl`), so that exactly the
//! contributions that made the image are seen. With q = g·c + g_A, ∂L/∂αᵢ = Tᵢ qᵢ − Rᵢ/(1 − αᵢ), where R is what the splats
//! behind and the background contribute: it starts as g·colour of the finished pixel and loses wᵢ qᵢ at each splat (the
//! recurrence of 3D Gaussian splatting's backward pass, turned around so that nothing is divided by a small T).
//! Where an image has few tiles, each tile's list is cut into [segments](crate::render::segments) that are replayed side by
//! side: the forward pass leaves T and the colour so far at the beginning of each, from which R follows.
//! A gradient or colour that is not finite or absurdly large (≥ 1e12) counts as 0, so that every sum is finite.
//!
//! # Why per pixel, and why rows per instance
//!
//! Measured on lavapipe (8 lanes, AVX2; 50,000 Gaussians, 129,332 tile instances, 400×400 px), processor time over all
//! cores, on a shared machine (±10 %):
//!
//! | kernel | ms |
//! |---|---|
//! | `blend` (forward) | 54 |
//! | `blend_backward`, a row per instance | 72–82 |
//! | … and filling and summing the rows | 2 + 12 |
//! | `blend_backward_native`, a subgroup per tile / per subtile | 95–108 / 103–110 |
//! | `blend_backward`, compare-and-swap, per tile / per subtile | 105–122 / 123–145 |
//! | parameters and rows through shared memory (`STAGE` 1) | 300–325 |
//! | per Gaussian: a lane is a splat, pixels pass from lane to lane | 163–200 |
//!
//! The last one, which writes a splat's row without any reduction, lost by a factor of 2.3 and was dropped: each pixel's
//! state (T, R, four gradients) has to be shifted and fed by 14 shuffles per step, size − 1 of 64 + size − 1 steps per subtile
//! fill or drain the pipeline, and lanes whose splat misses the subtile idle. What made it attractive elsewhere is the price
//! of full reductions (five shuffles for each of the sums at 32 lanes); the halving butterfly needs 13 for all, and hands each total to one lane.
//!
//! Rows per instance are both deterministic and fastest here: the row of a splat is summed over the whole tile in registers
//! and stored once. On a GPU they cost 144 B of traffic per instance (fill, store, load) and ask for one subgroup per tile,
//! which leaves a small image with few subgroups, while native atomics of neighbouring lanes on neighbouring words are merged
//! in the cache: [`Accumulation::of_device`] takes those where the device has them and no determinism is asked for (by this
//! reasoning, not by measurement).

pub mod blend_backward_native;
pub mod sum_instance_gradients;
mod twin;

use self::blend_backward_native::BLEND_BACKWARD_NATIVE;
use self::sum_instance_gradients::{SUM_INSTANCE_GRADIENTS, SumInstanceGradientsBuffers, SumInstanceGradientsPush};
use self::twin::blend_backward_twin;
use crate::error::{Error, Result};
use crate::gpu::kernel::{Kernel, Tolerance, Workload};
use crate::gpu::{Buffer, Gpu, Groups, Recorder, Slice};
use crate::render::blend::{BLEND_THREADS, Stage, pixels_per_lane, subtile};
use crate::render::frame::Frame;
use crate::render::limits::TILE_SIZE;
use crate::render::pipeline::{FrameBuffers, Shape};
use crate::render::segments::{Segments, States};
use crate::render::tiles::SlotBuffers;
use crate::render::work_buffers::WorkBuffers;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] =
    &[&BLEND_BACKWARD.kernel, &BLEND_BACKWARD_NATIVE.kernel, &SUM_INSTANCE_GRADIENTS.kernel];

/// Words of a row of `splat_gradient` or `instance_gradient`.
pub const ROW_WORDS: u32 = 12;
/// vec4 parts of a row: threads of `sum_instance_gradients` per Gaussian.
const ROW_PARTS: u64 = ROW_WORDS as u64 / 4;
/// Words of a row that are sums.
pub const SUMS: usize = 12;
/// Those in front, which are always summed; the others are of absolute gradients.
pub const SIGNED_SUMS: usize = 10;
/// Gradients and colours from here on count as 0.
pub const FAR_VALUE: f32 = 1e12;
/// The same for their product summed over a pixel.
pub const FAR_PRODUCT: f32 = 1e24;

/// How the rows of a Gaussian's instances become one (spec constant `ACCUMULATE`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Accumulation {
    /// One row per tile instance, then summed in slot order: the same bits on every run.
    Instances = 0,
    /// Float atomics of the device.
    NativeAtomics = 1,
    /// Compare-and-swap on the bits.
    CompareAndSwap = 2,
}

impl Accumulation {
    /// The best way for a device: per instance on a CPU, or when the bits must be the same on every run, or when there are no
    /// float atomics; native atomics otherwise.
    pub fn of_device(gpu: &Gpu, deterministic: bool) -> Self {
        let native = gpu.info().capabilities.float_atomics && !gpu.info().is_cpu();
        if native && !deterministic { Self::NativeAtomics } else { Self::Instances }
    }
}

crate::gpu_constants! {
    /// Specialisation constants of `blend_backward`.
    pub struct BlendBackwardConstants {
        /// An [`Accumulation`].
        accumulate,
        /// A [`Stage`].
        stage,
        /// Of one subtile; at most 16.
        pixels_per_lane,
        /// Of one subgroup: 1, 2 or 4, at most those of a tile.
        subtiles,
        /// Most segments of a tile's list; 1: lists are whole.
        segments,
        /// Least splats of a segment.
        least_segment,
        /// 1: with the sums of absolute gradients; else they are 0.
        absolute,
    }
}

crate::gpu_buffers! {
    /// Buffers of `blend_backward`.
    pub struct BlendBackwardBuffers {
        frame: Read Struct(Frame),
        /// `uint[2·tiles]`: first and last + 1 instance of a tile.
        ranges: Read U32,
        /// `uint[instances]`: slots for [`Accumulation::Instances`], else Gaussians.
        values: Read U32,
        /// The Gaussian of each slot; only for [`Accumulation::Instances`].
        gaussian_of_slot: optional Read U32,
        /// `vec4[3·N]`.
        splats: Read F32,
        /// `vec4[H·W]`.
        color: Read F32,
        /// `vec4[H·W]`: dL/d(r, g, b, A).
        image_gradient: Read F32,
        /// `float[12·…]`, zero before: by slot for [`Accumulation::Instances`], else by Gaussian.
        gradient_rows: Atomic F32,
        /// Of `blend_states`; only with segments.
        states: optional Read F32,
    }
}

const TOLERANCE: Tolerance = Tolerance { absolute: 1e-4, relative: 1e-3, flips: 1e-3 };

crate::kernel! {
    /// Gradient rows without float atomics: `instance_gradient` by slot, or, for [`Accumulation::CompareAndSwap`],
    /// `splat_gradient` by Gaussian.
    pub static BLEND_BACKWARD: BlendBackward = {
        name: "blend_backward",
        doc: "replays the blending front to back and sums each splat's gradient: a row per instance, or added to the \
              Gaussian's by compare-and-swap",
        local_size: BLEND_THREADS,
        constants: BlendBackwardConstants,
        push: (),
        buffers: BlendBackwardBuffers,
        twin: |call| blend_backward_twin(call.constants, call.buffers),
        tolerance: TOLERANCE,
        bytes: blend_backward_bytes,
    }
}

/// Each instance's index, splat and row once, each pixel's colour and gradient once.
fn blend_backward_bytes(work: &Workload) -> u64 {
    work.get("instances") * (8 + 48 + 40) + work.get("pixels") * 32 + work.get("tiles") * 8
}

impl BlendBackwardConstants {
    /// Constants for a device.
    pub fn new(
        accumulation: Accumulation,
        stage: Stage,
        subgroup_size: u32,
        subtiles: u32,
        segments: Segments,
        absolute: bool,
    ) -> Self {
        Self {
            accumulate: accumulation as u32,
            stage: stage as u32,
            pixels_per_lane: pixels_per_lane(subgroup_size),
            subtiles,
            segments: segments.per_list,
            least_segment: segments.least,
            absolute: absolute.into(),
        }
    }
}

/// Subtiles of a tile.
pub fn subtiles_of_tile(subgroup_size: u32) -> u32 {
    let [columns, _, rows] = subtile(subgroup_size, pixels_per_lane(subgroup_size));
    (TILE_SIZE / columns) * (TILE_SIZE / rows)
}

/// Workgroups for so many segments, those of a list times the tiles, when a subgroup owns `subtiles` subtiles.
pub fn groups(segments: u32, subgroup_size: u32, subtiles: u32) -> u64 {
    let subgroups = u64::from(segments) * u64::from(subtiles_of_tile(subgroup_size) / subtiles);
    subgroups.div_ceil(u64::from(BLEND_THREADS / subgroup_size))
}

/// What the forward pass left, and the gradient of its image.
#[derive(Debug, Clone)]
pub struct BackwardInput {
    /// [`Frame`].
    pub frame: Slice,
    /// Counters of the frame.
    pub counters: Slice,
    /// `uint[2·tiles]`.
    pub ranges: Slice,
    /// Tile lists: slots for [`Accumulation::Instances`], else Gaussians.
    pub values: Slice,
    /// `uint[N]`.
    pub tile_count: Slice,
    /// `vec4[3N]`.
    pub splats: Slice,
    /// `vec4[H·W]`.
    pub color: Slice,
    /// `vec4[H·W]`: dL/d(r, g, b, A).
    pub image_gradient: Slice,
    /// Gaussians.
    pub gaussians: u32,
    /// Tiles of the image.
    pub tiles: u32,
    /// Where the forward pass kept the states of the lists' segments.
    pub states: Option<States>,
    /// Whether absolute gradients by the centres are summed too.
    pub absolute: bool,
}

/// Where the gradients go, which also says how they are added.
#[derive(Debug, Clone)]
pub enum BackwardTarget {
    /// [`Accumulation::Instances`]: the slots of the forward pass and `instance_gradient float[12·instance capacity]`.
    Instances(SlotBuffers, Slice),
    /// [`Accumulation::NativeAtomics`]; the device must have `shaderBufferFloat32AtomicAdd`.
    NativeAtomics,
    /// [`Accumulation::CompareAndSwap`].
    CompareAndSwap,
}

/// Appends the backward pass: `splat_gradient float[12·N]` is overwritten.
///
/// # Errors
/// `Usage` for native atomics on a device without them; `Kernel` or `Limit` when a buffer is too small or too large.
pub fn record(
    gpu: &Gpu,
    r: &mut Recorder,
    input: &BackwardInput,
    target: &BackwardTarget,
    splat_gradient: &Slice,
) -> Result<()> {
    if matches!(target, BackwardTarget::NativeAtomics) && !gpu.info().capabilities.float_atomics {
        let found = "native float atomics on a device without shaderBufferFloat32AtomicAdd";
        return Err(Error::usage("gradient accumulation", found, "compare-and-swap or per-instance rows"));
    }
    let (accumulation, kernel, rows): (_, &Kernel, _) = match target {
        BackwardTarget::Instances(_, rows) => (Accumulation::Instances, &BLEND_BACKWARD, rows),
        BackwardTarget::NativeAtomics => (Accumulation::NativeAtomics, &BLEND_BACKWARD_NATIVE, splat_gradient),
        BackwardTarget::CompareAndSwap => (Accumulation::CompareAndSwap, &BLEND_BACKWARD, splat_gradient),
    };
    let size = gpu.subgroup_size_of(kernel);
    // A subgroup per subtile keeps a GPU fuller, a subgroup per tile writes fewer rows; only the latter needs no atomics.
    let whole = accumulation == Accumulation::Instances || gpu.info().is_cpu();
    let subtiles = if whole { subtiles_of_tile(size) } else { 1 };
    r.fill(rows, 0)?;
    let segments = input.states.as_ref().map_or(Segments::WHOLE, |s| s.segments);
    let (stage, absolute) = (Stage::of_device(gpu), input.absolute);
    let constants = BlendBackwardConstants::new(accumulation, stage, size, subtiles, segments, absolute);
    let groups = Groups::Direct(groups(input.tiles * segments.per_list, size, subtiles));
    let buffers = input.buffers(target, rows);
    match target {
        BackwardTarget::NativeAtomics => r.dispatch(&BLEND_BACKWARD_NATIVE, constants, (), buffers, groups)?,
        _ => r.dispatch(&BLEND_BACKWARD, constants, (), buffers, groups)?,
    }
    if let BackwardTarget::Instances(slots, rows) = target {
        let push = SumInstanceGradientsPush { gaussians: input.gaussians };
        let buffers = SumInstanceGradientsBuffers {
            counters: input.counters.clone(),
            tile_count: input.tile_count.clone(),
            first_slot: slots.first_slot.whole(),
            instance_gradient: rows.clone(),
            splat_gradient: splat_gradient.clone(),
        };
        let groups = (u64::from(input.gaussians) * ROW_PARTS).div_ceil(256).max(1);
        r.dispatch(&SUM_INSTANCE_GRADIENTS, (), push, buffers, Groups::Direct(groups))?;
    }
    Ok(())
}

impl BackwardInput {
    /// What the forward pass left in these buffers; without absolute gradients.
    pub(crate) fn new(
        work: &WorkBuffers,
        frame: &FrameBuffers,
        image_gradient: &Buffer,
        gaussians: u32,
        shape: &Shape,
    ) -> Self {
        Self {
            frame: Slice::from(&frame.frame),
            counters: work.counters.clone(),
            ranges: work.ranges.whole(),
            values: work.values.whole(),
            tile_count: Slice::from(&work.tile_count),
            splats: Slice::from(&work.splats),
            color: Slice::from(&frame.color),
            image_gradient: Slice::from(image_gradient),
            gaussians,
            tiles: shape.tiles,
            states: shape.states.clone(),
            absolute: false,
        }
    }

    fn buffers(&self, target: &BackwardTarget, rows: &Slice) -> BlendBackwardBuffers<Slice> {
        let gaussian_of_slot = match target {
            BackwardTarget::Instances(slots, _) => Some(slots.gaussian_of_slot.whole()),
            BackwardTarget::NativeAtomics | BackwardTarget::CompareAndSwap => None,
        };
        BlendBackwardBuffers {
            frame: self.frame.clone(),
            ranges: self.ranges.clone(),
            values: self.values.clone(),
            gaussian_of_slot,
            splats: self.splats.clone(),
            color: self.color.clone(),
            image_gradient: self.image_gradient.clone(),
            gradient_rows: rows.clone(),
            states: self.states.as_ref().map(|s| s.buffer.clone()),
        }
    }
}

#[cfg(test)]
mod tests;

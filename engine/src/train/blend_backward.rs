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
//! | 10, 11 | 0 |
//!
//! The forward pass is replayed front to back with its own arithmetic (`glsl/lib/blend.glsl`), so that exactly the
//! contributions that made the image are seen. With q = g·c + g_A, ∂L/∂αᵢ = Tᵢ qᵢ − Rᵢ/(1 − αᵢ), where R is what the splats
//! behind and the background contribute: it starts as g·colour of the finished pixel and loses wᵢ qᵢ at each splat (the
//! recurrence of 3D Gaussian splatting's backward pass, turned around so that nothing is divided by a small T).
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
//! of ten full reductions (50 shuffles at 32 lanes); the halving butterfly needs 12, and hands each total to one lane.
//!
//! Rows per instance are both deterministic and fastest here: the row of a splat is summed over the whole tile in registers
//! and stored once. On a GPU they cost 144 B of traffic per instance (fill, store, load) and ask for one subgroup per tile,
//! which leaves a small image with few subgroups, while native atomics of neighbouring lanes on neighbouring words are merged
//! in the cache: [`Accumulation::of_device`] takes those where the device has them and no determinism is asked for (by this
//! reasoning, not by measurement).

mod twin;

use self::twin::{blend_backward_twin, sum_instance_gradients_twin};
use crate::error::{Error, Result};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, Workload};
use crate::gpu::{Gpu, Groups, Recorder, Slice};
use crate::render::blend::{BLEND_THREADS, Stage, pixels_per_lane, subtile};
use crate::render::frame::Frame;
use crate::render::limits::TILE_SIZE;
use crate::render::tiles::SlotBuffers;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&BLEND_BACKWARD, &BLEND_BACKWARD_NATIVE, &SUM_INSTANCE_GRADIENTS];

/// Words of a row of `splat_gradient` or `instance_gradient`.
pub const ROW_WORDS: u32 = 12;
/// vec4 parts of a row: threads of `sum_instance_gradients` per Gaussian.
const ROW_PARTS: u64 = ROW_WORDS as u64 / 4;
/// Words of a row that are sums.
pub const SUMS: usize = 10;
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

const SPEC: &[&str] = &["SUBGROUP_SIZE", "ACCUMULATE", "STAGE", "PIXELS_PER_LANE", "SUBTILES"];
const fn bindings(element: Element) -> [Binding; 8] {
    [
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("ranges", Access::Read, Element::U32),
        Binding::new("values", Access::Read, Element::U32),
        Binding::new("gaussian_of_slot", Access::Read, Element::U32),
        Binding::new("splats", Access::Read, Element::F32),
        Binding::new("color", Access::Read, Element::F32),
        Binding::new("image_gradient", Access::Read, Element::F32),
        Binding::new("gradient_rows", Access::Atomic, element),
    ]
}
const TOLERANCE: Tolerance = Tolerance { absolute: 1e-4, relative: 1e-3, flips: 1e-3 };

/// Gradient rows without float atomics. `gradient_rows`, zero before: `instance_gradient` by slot, or, for
/// [`Accumulation::CompareAndSwap`], `splat_gradient` by Gaussian (then `values` are Gaussians).
pub static BLEND_BACKWARD: Kernel = Kernel {
    name: "blend_backward",
    doc: "replays the blending front to back and sums each splat's gradient: a row per instance, or added to the \
          Gaussian's by compare-and-swap",
    local_size: BLEND_THREADS,
    spec: SPEC,
    push: &[],
    bindings: &bindings(Element::F32),
    twin: blend_backward_twin,
    tolerance: TOLERANCE,
    bytes: blend_backward_bytes,
    spirv: include_bytes!("../../../spirv_cache/blend_backward.spv"),
};

/// The same with the device's float atomics: `gradient_rows` is `splat_gradient`, `values` are Gaussians.
pub static BLEND_BACKWARD_NATIVE: Kernel = Kernel {
    name: "blend_backward_native",
    doc: "blend_backward that adds to the Gaussian's row with the device's float atomics",
    local_size: BLEND_THREADS,
    spec: SPEC,
    push: &[],
    bindings: &bindings(Element::F32),
    twin: blend_backward_twin,
    tolerance: TOLERANCE,
    bytes: blend_backward_bytes,
    spirv: include_bytes!("../../../spirv_cache/blend_backward_native.spv"),
};

/// Each instance's index, splat and row once, each pixel's colour and gradient once.
fn blend_backward_bytes(work: &Workload) -> u64 {
    work.get("instances") * (8 + 48 + 40) + work.get("pixels") * 32 + work.get("tiles") * 8
}

crate::gpu_struct! {
    /// Push constants of `sum_instance_gradients`.
    pub struct SumInstanceGradientsPush {
        /// N.
        pub gaussians: u32,
    }
}

/// Sums of the instances' rows. Dispatch ceil(3 N / 256) workgroups.
pub static SUM_INSTANCE_GRADIENTS: Kernel = Kernel {
    name: "sum_instance_gradients",
    doc: "sums the gradient rows of each Gaussian's instances in slot order",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: SumInstanceGradientsPush::FIELDS,
    bindings: &[
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("tile_count", Access::Read, Element::U32),
        Binding::new("first_slot", Access::Read, Element::U32),
        Binding::new("instance_gradient", Access::Read, Element::F32),
        Binding::new("splat_gradient", Access::Write, Element::F32),
    ],
    twin: sum_instance_gradients_twin,
    tolerance: Tolerance { absolute: 1e-5, relative: 1e-5, flips: 0.0 },
    bytes: |w| w.get("instances") * 48 + w.get("gaussians") * (8 + 48),
    spirv: include_bytes!("../../../spirv_cache/sum_instance_gradients.spv"),
};

/// Specialisation of `blend_backward` for a device: constants from id 1 on.
pub fn spec(accumulation: Accumulation, stage: Stage, subgroup_size: u32, subtiles: u32) -> [u32; 4] {
    [accumulation as u32, stage as u32, pixels_per_lane(subgroup_size), subtiles]
}

/// Subtiles of a tile.
pub fn subtiles_of_tile(subgroup_size: u32) -> u32 {
    let [columns, _, rows] = subtile(subgroup_size, pixels_per_lane(subgroup_size));
    (TILE_SIZE / columns) * (TILE_SIZE / rows)
}

/// Workgroups for `tiles` tiles when a subgroup owns `subtiles` subtiles.
pub fn groups(tiles: u32, subgroup_size: u32, subtiles: u32) -> u64 {
    let subgroups = u64::from(tiles) * u64::from(subtiles_of_tile(subgroup_size) / subtiles);
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
    let (accumulation, kernel, rows) = match target {
        BackwardTarget::Instances(_, rows) => (Accumulation::Instances, &BLEND_BACKWARD, rows),
        BackwardTarget::NativeAtomics => (Accumulation::NativeAtomics, &BLEND_BACKWARD_NATIVE, splat_gradient),
        BackwardTarget::CompareAndSwap => (Accumulation::CompareAndSwap, &BLEND_BACKWARD, splat_gradient),
    };
    let size = gpu.subgroup_size_of(kernel);
    // A subgroup per subtile keeps a GPU fuller, a subgroup per tile writes fewer rows; only the latter needs no atomics.
    let whole = accumulation == Accumulation::Instances || gpu.info().is_cpu();
    let subtiles = if whole { subtiles_of_tile(size) } else { 1 };
    r.fill(rows, 0)?;
    let gaussian_of_slot = match target {
        BackwardTarget::Instances(slots, _) => Slice::from(&slots.gaussian_of_slot),
        _ => input.values.clone(),
    };
    let buffers = [
        input.frame.clone(),
        input.ranges.clone(),
        input.values.clone(),
        gaussian_of_slot,
        input.splats.clone(),
        input.color.clone(),
        input.image_gradient.clone(),
        rows.clone(),
    ];
    let spec = spec(accumulation, Stage::of_device(gpu), size, subtiles);
    r.dispatch_untyped(kernel, &spec, &[], &buffers, Groups::Direct(groups(input.tiles, size, subtiles)))?;
    if let BackwardTarget::Instances(slots, rows) = target {
        let push = SumInstanceGradientsPush { gaussians: input.gaussians };
        let buffers = [
            input.counters.clone(),
            input.tile_count.clone(),
            Slice::from(&slots.first_slot),
            rows.clone(),
            splat_gradient.clone(),
        ];
        let groups = (u64::from(input.gaussians) * ROW_PARTS).div_ceil(256).max(1);
        r.dispatch_untyped(&SUM_INSTANCE_GRADIENTS, &[], bytemuck::bytes_of(&push), &buffers, Groups::Direct(groups))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;

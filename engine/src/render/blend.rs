//! Kernel `blend`: front-to-back blending of each tile's splats into the image.
//!
//! Reads `ranges uint[2·tiles]` (first and last + 1 instance of a tile), `values uint[instances]` (each
//! instance's Gaussian and the quadrants that it reaches, in depth order within a tile) and `splats` (stored as [`super::splat`] says). Writes every pixel of `color vec4[H·W]` (Σ c α T + T·background,
//! 1 − T) and, when `WITH_DEPTH` is 1, `depth float[H·W]` (Σ z α T). When `WITH_SLOTS` is 1,
//! `values` are slots and `gaussian_of_slot` leads to the instances (see [`SlotBuffers`](super::tiles::SlotBuffers)).
//!
//! Kernels `blend_packed`, `blend_rgba8`, `blend_rgba16f` and `blend_rgba32f` do the same and store pixels as host programs take
//! them ([`PixelFormat`](super::PixelFormat)).
//!
//! One subgroup blends one subtile ([`subtile`]); the formulas are those of 3D Gaussian splatting's forward pass with the
//! threshold α ≥ 1/255 tested before exp2, in the log2 domain.

pub(super) mod twin;

pub(crate) use twin::splat_at;

use super::frame::Frame;
use super::limits::TILE_SIZE;
use crate::gpu::Gpu;
use crate::gpu::kernel::{Tolerance, Workload};

/// Threads per workgroup: one subgroup of the largest size, several of a smaller one.
pub const BLEND_THREADS: u32 = 128;
/// Largest α.
pub const MAX_ALPHA: f32 = 0.99;
/// The splat that would take the transmittance below this ends the pixel, undrawn. The definition says 1e-4; two splats at
/// the largest α leave exactly that, which is not below it, but (1 − 0.99f)² rounds to 9.99998e-5: hence a hair less.
pub const MIN_TRANSMITTANCE: f32 = 9.9999e-5;

/// How a surviving splat's parameters reach all lanes of a subgroup (spec constant `STAGE`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Stage {
    /// `subgroupShuffle`.
    Shuffle = 0,
    /// Through the subgroup's slice of shared memory.
    Shared = 1,
    /// Read again from `splats` at a uniform address.
    Reread = 2,
}

impl Stage {
    /// The stage for a device: on a CPU a shuffle is an extract; on a GPU shared memory broadcasts a word for free.
    pub fn of_device(gpu: &Gpu) -> Self {
        if gpu.info().is_cpu() { Self::Shuffle } else { Self::Shared }
    }
}

crate::gpu_constants! {
    /// Specialisation constants of the kernels that blend.
    pub struct BlendConstants {
        /// 1: `depth` is written.
        with_depth,
        /// A [`Stage`].
        stage,
        /// See [`pixels_per_lane`].
        pixels_per_lane,
        /// 1: `values` are slots.
        with_slots,
        /// Least α that counts ([`Ellipse::with_constants`](super::ellipse::Ellipse::with_constants)).
        alpha_cut,
        /// Bits of the transmittance at which a pixel ends; 0 for [`MIN_TRANSMITTANCE`].
        transmittance_stop,
        /// How splats are stored ([`super::splat`]).
        packing,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`BLEND`].
    pub struct BlendBuffers {
        frame: Read Struct(Frame),
        ranges: Read U32,
        values: Read U32,
        splats: Read F32,
        color: Write F32,
        depth: optional Write F32,
        gaussian_of_slot: optional Read U32,
    }
}

crate::kernel! {
    /// Blends each tile's splats front to back.
    pub static BLEND: Blend = {
        name: "blend",
        doc: "front-to-back blending, one subgroup per subtile of pixels",
        local_size: BLEND_THREADS,
        constants: BlendConstants,
        push: (),
        buffers: BlendBuffers,
        twin: twin::blend,
        tolerance: BLEND_TOLERANCE,
        bytes: blend_bytes,
    }
}

/// exp2 may be off by units in the last place; a splat at the threshold of 1/255, or a pixel at the transmittance stop, may flip.
pub(super) const BLEND_TOLERANCE: Tolerance = Tolerance { absolute: 1e-4, relative: 1e-4, flips: 1e-3 };

/// Each instance's index and splat once, each pixel's colour (and depth) once, each tile's range once.
pub(super) fn blend_bytes(work: &Workload) -> u64 {
    work.get("instances") * (4 + work.get("splat_bytes"))
        + work.get("pixels") * (16 + if work.get("depth") > 0 { 4 } else { 0 })
        + work.get("tiles") * 8
}

/// Pixels per lane for a subgroup size, so that a subtile is 8×8 px (4×16 at size 4, 16×8 at size 128).
pub fn pixels_per_lane(subgroup_size: u32) -> u32 {
    match subgroup_size {
        0..=4 => 16,
        5..=64 => 64 / subgroup_size,
        _ => 1,
    }
}

/// A subtile's shape: columns, rows per lane row, rows in all (px).
pub fn subtile(subgroup_size: u32, pixels_per_lane: u32) -> [u32; 3] {
    let columns = if subgroup_size >= 128 { 16 } else { subgroup_size.min(8) };
    let lane_rows = subgroup_size / columns;
    [columns, lane_rows, lane_rows * pixels_per_lane]
}

/// Workgroups that blend `tiles` tiles.
pub fn groups(tiles: u32, subgroup_size: u32, pixels_per_lane: u32) -> u64 {
    let [columns, _, rows] = subtile(subgroup_size, pixels_per_lane);
    let subtiles = u64::from(tiles) * u64::from((TILE_SIZE / columns) * (TILE_SIZE / rows));
    subtiles.div_ceil(u64::from(BLEND_THREADS / subgroup_size))
}

//! Kernel `blend`: front-to-back blending of each tile's splats into the image.
//!
//! Reads `ranges uint[2·tiles]` (first and last + 1 instance of a tile), `values uint[instances]` (the Gaussian of each
//! instance, in depth order within a tile) and `splats` (stored as [`super::splat`] says). Writes every pixel of `color vec4[H·W]` (Σ c α T + T·background,
//! 1 − T) and, when `WITH_DEPTH` is 1, `depth float[H·W]` (Σ z α T; else a dummy of any size). When `WITH_SLOTS` is 1,
//! `values` are slots and `gaussian_of_slot` leads to the Gaussians (see [`SlotBuffers`](super::tiles::SlotBuffers)).
//!
//! Kernel `blend_packed` does the same and stores pixels in the format of a picture ([`PixelFormat`]): in a frame that goes
//! into a host's image this saves writing, reading and converting 16 bytes per pixel.
//!
//! One subgroup blends one subtile ([`subtile`]); the formulas are those of 3D Gaussian splatting's forward pass with the
//! threshold α ≥ 1/255 tested before exp2, in the log2 domain.

use super::ellipse::{Ellipse, log2_cut};
use super::frame::Frame;
use super::half::{self, HALF_MAX};
use super::limits::TILE_SIZE;
use super::splat::{Splat, unpack_splat};
use super::twin::{set_f32, set_vec4, spec, struct_at};
use crate::gpu::Gpu;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall, Workload};

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

/// Blends each tile's splats front to back.
pub static BLEND: Kernel = BASE;

/// What all kernels have that blend tiles.
pub(super) const BASE: Kernel = Kernel {
    name: "blend",
    doc: "front-to-back blending, one subgroup per subtile of pixels",
    local_size: BLEND_THREADS,
    spec: &[
        "SUBGROUP_SIZE",
        "WITH_DEPTH",
        "STAGE",
        "PIXELS_PER_LANE",
        "WITH_SLOTS",
        "ALPHA_CUT",
        "TRANSMITTANCE_STOP",
        "PACKING",
    ],
    push: &[],
    bindings: &bindings(Binding::new("color", Access::Write, Element::F32)),
    twin: blend_twin,
    // exp2 may be off by units in the last place; a splat at the threshold of 1/255, or a pixel at the transmittance stop,
    // may flip.
    tolerance: Tolerance { absolute: 1e-4, relative: 1e-4, flips: 1e-3 },
    bytes: blend_bytes,
    spirv: include_bytes!("../../../spirv_cache/blend.spv"),
};

const fn bindings(pixels: Binding) -> [Binding; 7] {
    [
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("ranges", Access::Read, Element::U32),
        Binding::new("values", Access::Read, Element::U32),
        Binding::new("splats", Access::Read, Element::F32),
        pixels,
        Binding::new("depth", Access::Write, Element::F32),
        Binding::new("gaussian_of_slot", Access::Read, Element::U32),
    ]
}

/// Format of the pixels that a frame ends in; always R, G, B = Σ c α T + T·background and A = 1 − T, which is premultiplied
/// colour when the background is black.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[repr(u32)]
pub enum PixelFormat {
    /// `VK_FORMAT_R8G8B8A8_UNORM` (or `_SRGB`: the bytes are the same), clamped to \[0, 1\] and rounded to the nearest level.
    #[default]
    Rgba8 = 0,
    /// `VK_FORMAT_B8G8R8A8_UNORM`, as [`PixelFormat::Rgba8`].
    Bgra8 = 1,
    /// `VK_FORMAT_R16G16B16A16_SFLOAT`, within ±65504.
    Rgba16F = 2,
    /// `VK_FORMAT_R32G32B32A32_SFLOAT`: the engine's own bits.
    Rgba32F = 3,
}

impl PixelFormat {
    /// Bytes of a pixel.
    pub fn bytes(self) -> u64 {
        [4, 4, 8, 16][self as usize]
    }

    /// A pixel as `blend_packed` stores it; the first [`PixelFormat::bytes`] count.
    pub fn pack(self, value: [f32; 4]) -> [u32; 4] {
        let half = |a: f32, b: f32| half::pack([a, b].map(|v| v.clamp(-HALF_MAX, HALF_MAX)));
        let level = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u32;
        let [r, g, b, a] = value;
        match self {
            Self::Rgba8 => [level(r) | level(g) << 8 | level(b) << 16 | level(a) << 24, 0, 0, 0],
            Self::Bgra8 => [level(b) | level(g) << 8 | level(r) << 16 | level(a) << 24, 0, 0, 0],
            Self::Rgba16F => [half(r, g), half(b, a), 0, 0],
            Self::Rgba32F => value.map(f32::to_bits),
        }
    }

    /// Colour and alpha of a stored pixel.
    pub fn unpack(self, words: &[u32]) -> [f32; 4] {
        let level = |shift: u32| ((words[0] >> shift) & 255) as f32 / 255.0;
        let half = |i: usize| half::to_f32(words[i / 2] >> (16 * (i % 2)) & 0xFFFF);
        match self {
            Self::Rgba8 => [level(0), level(8), level(16), level(24)],
            Self::Bgra8 => [level(16), level(8), level(0), level(24)],
            Self::Rgba16F => [half(0), half(1), half(2), half(3)],
            Self::Rgba32F => std::array::from_fn(|i| f32::from_bits(words[i])),
        }
    }
}

/// `blend` into an 8-bit or half-float picture.
pub static BLEND_PACKED: Kernel = Kernel {
    name: "blend_packed",
    doc: "blend, pixels stored in the format of a host's image",
    spec: &[
        "SUBGROUP_SIZE",
        "WITH_DEPTH",
        "STAGE",
        "PIXELS_PER_LANE",
        "WITH_SLOTS",
        "ALPHA_CUT",
        "TRANSMITTANCE_STOP",
        "PACKING",
        "FORMAT",
    ],
    bindings: &bindings(Binding::new("pixels", Access::Write, Element::U32)),
    // The tolerance is that of the depth, as for `blend`; a pixel's level may be the next one.
    twin: blend_packed_twin,
    bytes: blend_packed_bytes,
    spirv: include_bytes!("../../../spirv_cache/blend_packed.spv"),
    ..BASE
};

/// As `blend`, with the pixels' own size.
pub(super) fn blend_packed_bytes(work: &Workload) -> u64 {
    blend_bytes(work) - work.get("pixels") * 16 + work.get("pixels") * work.get("pixel_bytes")
}

/// Each instance's index and splat once, each pixel's colour (and depth) once, each tile's range once.
fn blend_bytes(work: &Workload) -> u64 {
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

/// What ends a splat and a pixel.
struct Limits {
    log2_cut: f32,
    min_transmittance: f32,
}

/// A pixel's state.
#[derive(Clone, Copy)]
struct Pixel {
    transmittance: f32,
    colour: [f32; 3],
    depth: f32,
}

fn blend_splat(pixel: &mut Pixel, [first, second, third]: Splat, limits: &Limits, x: f32, y: f32) {
    let (dx, dy) = (x - first[0], y - first[1]);
    let u = first[2] * dx + first[3] * dy;
    let v = second[0] * dy;
    let log2_alpha = second[1] - u * u - v * v;
    let live = log2_alpha >= -limits.log2_cut && pixel.transmittance > 0.0;
    let alpha = if live { log2_alpha.exp2().min(MAX_ALPHA) } else { 0.0 };
    let weight = alpha * pixel.transmittance;
    let after = pixel.transmittance - weight;
    let stop = live && after < limits.min_transmittance;
    let weight = if stop { 0.0 } else { weight };
    pixel.transmittance = if stop { -pixel.transmittance } else { after };
    (0..3).for_each(|c| pixel.colour[c] += weight * third[c]);
    pixel.depth += weight * second[2];
}

fn blend_twin(call: &mut TwinCall<'_>) {
    blend_tiles(call, set_vec4);
}

fn blend_packed_twin(call: &mut TwinCall<'_>) {
    let format = [PixelFormat::Rgba8, PixelFormat::Bgra8, PixelFormat::Rgba16F][spec(call, 8) as usize];
    blend_into(call, format);
}

/// Blends into pixels of a format.
pub(super) fn blend_into(call: &mut TwinCall<'_>, format: PixelFormat) {
    let words = format.bytes() as usize / 4;
    blend_tiles(call, |target, at, value| {
        target[words * at..words * (at + 1)].copy_from_slice(&format.pack(value)[..words]);
    });
}

fn blend_tiles(call: &mut TwinCall<'_>, store_pixel: impl Fn(&mut [u32], usize, [f32; 4])) {
    let frame: Frame = struct_at(&call.buffers[0], 0);
    let with_depth = spec(call, 1) == 1;
    let with_slots = spec(call, 4) == 1;
    let (alpha_cut, stop, packing) = (spec(call, 5), spec(call, 6), spec(call, 7));
    let min_transmittance = if stop == 0 { MIN_TRANSMITTANCE } else { f32::from_bits(stop) };
    let limits = Limits { log2_cut: log2_cut(alpha_cut), min_transmittance };
    let [columns, _, rows] = subtile(spec(call, 0), spec(call, 3));
    let ([width, height], tiles_x) = (frame.size, frame.tiles[0]);
    for tile in 0..frame.tile_count {
        let (tile_x, tile_y) = (tile % tiles_x * TILE_SIZE, tile / tiles_x * TILE_SIZE);
        let range = call.buffers[1][2 * tile as usize] as usize..call.buffers[1][2 * tile as usize + 1] as usize;
        for inside in 0..(TILE_SIZE / columns) * (TILE_SIZE / rows) {
            let x0 = tile_x + columns * (inside % (TILE_SIZE / columns));
            let y0 = tile_y + rows * (inside / (TILE_SIZE / columns));
            let [x_low, y_low] = [x0 as f32 + 0.5, y0 as f32 + 0.5];
            let [x_high, y_high] = [x_low + (columns - 1) as f32, y_low + (rows - 1) as f32];
            let mut pixels =
                vec![Pixel { transmittance: 1.0, colour: [0.0; 3], depth: 0.0 }; (columns * rows) as usize];
            for at in range.clone() {
                let value = call.buffers[2][at];
                let index = if with_slots { call.buffers[6][value as usize] } else { value } as usize;
                let splat = unpack_splat(packing, &call.buffers[3], index);
                let e = Ellipse::of_splat(splat[0], splat[1]).with_constants(alpha_cut, 0);
                let x = e.row_interval(y_low, y_high);
                if x[0] <= x_high && x[1] >= x_low && x[0] <= x[1] {
                    for (i, pixel) in (0..).zip(&mut pixels) {
                        blend_splat(pixel, splat, &limits, x_low + (i % columns) as f32, y_low + (i / columns) as f32);
                    }
                }
            }
            for (i, pixel) in (0..).zip(&pixels) {
                let (x, y) = (x0 + i % columns, y0 + i / columns);
                if x < width && y < height {
                    let at = (y * width + x) as usize;
                    let rest = pixel.transmittance.abs();
                    let [r, g, b] = std::array::from_fn(|c| pixel.colour[c] + rest * frame.background[c]);
                    store_pixel(&mut call.buffers[4], at, [r, g, b, 1.0 - rest]);
                    if with_depth {
                        set_f32(&mut call.buffers[5], at, pixel.depth);
                    }
                }
            }
        }
    }
}

//! Kernel `deform_project`: moves, projects, culls and shades each Gaussian and counts the tiles it reaches, or appends it to their lists.
//!
//! One Gaussian per thread, 256 per workgroup. For each Gaussian of `mean [3][N]` it writes `tile_count[N]` (0 = culled)
//! and, for the visible ones only, `splats`, as `vec4[3N]`: (mean px, l11, l12), (l22, log2 opacity, z, 0), (r, g, b, 0),
//! or packed ([`super::splat`]).
//! Sums: tile instances in `instance_block[b]` per workgroup and in `[block_capacity + b / 256]` above it; `counters` 0 visible,
//! 1–2 instances (64 bits), 4 rejected; in `tile_end[k * TILE_PITCH]` how many more Gaussians reach tile k than tile k − 1. All of them
//! must be zeroed before.
//!
//! With `LISTS` = 1 `tile_end` counts the pairs of each tile's list instead, which are in `pairs`: the first of tile k at k
//! [`Frame::tile_room`], in any order. A list that has no room leaves out what is too much, and the frame fails.
//!
//! With `NONRIGID` = 1 it adds `nonrigid_offset float[10][N]`, planes dx 3, dq 4 (w,x,y,z), ds 3, to the moved Gaussian:
//! μ + dx, norm(q + dq), max(exp(log_scale) + ds, exp(−30)).
//!
//! Source of the formulas: EWA projection as in 3D Gaussian splatting with gsplat's clamp of the Jacobian; motion of
//! Superpoint Gaussian Splatting. Cholesky form and Cauchy–Binet determinant: see `conic_root`.

mod twin;

use super::frame::Frame;
use crate::gpu::kernel::{Tolerance, Workload};

crate::gpu_struct! {
    /// Push constants of [`DEFORM_PROJECT`].
    pub struct DeformProjectPush {
        /// Where the super sums start in `instance_block`: the number of blocks that it has room for.
        pub block_capacity: u32,
    }
}

/// Threads per workgroup = Gaussians per block sum.
pub const DEFORM_PROJECT_THREADS: u32 = 256;
/// `MOTION` of a scene that stands still.
pub const MOTION_STATIC: u32 = 0;
/// `MOTION` of a scene with a pose table `vec4[T][M][2]`: (r, 0), (τ, 0).
pub const MOTION_TABLE: u32 = 1;

crate::gpu_constants! {
    /// Specialisation constants of [`DEFORM_PROJECT`].
    pub struct DeformProjectConstants {
        /// SH degree, 0 to 3.
        sh_degree,
        /// [`MOTION_STATIC`] or [`MOTION_TABLE`].
        motion,
        /// 1: `nonrigid_offset` is added.
        nonrigid,
        /// Least α that counts ([`Ellipse::with_constants`](super::ellipse::Ellipse::with_constants)).
        alpha_cut,
        /// How tiles are culled, likewise.
        tile_cull,
        /// How splats are stored ([`super::splat`]).
        packing,
        /// How SH coefficients are stored ([`super::sh_storage`]).
        sh_storage,
        /// How centres are stored ([`super::mean_storage`]).
        mean_storage,
        /// Which optional parameters the scene has ([`Present`](crate::scene::parameter::Present)).
        optional,
        /// K of soft superpoints, 2 to 4, or 0 ([`super::superpoint_motion`]).
        blend,
        /// 1: [`Gaussians::antialiased`](crate::scene::Gaussians::antialiased).
        antialiased,
        /// 1: Gaussians are appended to the tile lists.
        lists,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`DEFORM_PROJECT`].
    pub struct DeformProjectBuffers {
        frame: Read Struct(Frame),
        /// `[3][N]`, world units ([`super::mean_storage`]).
        mean: Read U32,
        /// `[3][N]`
        log_scale: Read F32,
        /// `[N][4]` w, x, y, z, of any length > 0.
        rotation: Read F32,
        /// `[N]`
        opacity_logit: Read F32,
        /// `[N]`; of a moving scene without soft superpoints.
        superpoint_of_gaussian: optional Read U32,
        /// `vec4[T][M][2]`: (r, 0), (τ, 0); of a moving scene.
        pose: optional Read F32,
        /// `[3][N]` ([`super::sh_storage`]).
        sh_0: Read U32,
        /// `[9][N]`
        sh_1: optional Read U32,
        /// `[15][N]`
        sh_2: optional Read U32,
        /// `[21][N]`
        sh_3: optional Read U32,
        splats: Update F32,
        tile_count: Write U32,
        instance_block: Atomic U32,
        counters: Atomic U32,
        nonrigid_offset: optional Read F32,
        /// `[planes][N]` of the optional parameters.
        optional: optional Read F32,
        /// `[ceil(K/2)][N]`; of soft superpoints ([`superpoint_motion`](crate::render::superpoint_motion)).
        blend_index: optional Read U32,
        /// `[K-1][N]`; of soft superpoints.
        blend_weight: optional Read F32,
        /// `[T+1][`[`TILE_PITCH`](crate::render::limits::TILE_PITCH)`]`, row-major: changes from tile to tile
        /// ([`scan_tiles`](crate::render::scan_tiles)), or pairs of each list.
        tile_end: Atomic U32,
        /// `[T][`[`Frame::tile_room`]`][2]`: bits of the depth, and an instance ([`emit_tiles`](crate::render::emit_tiles)); of lists.
        pairs: optional Write U32,
    }
}

crate::kernel! {
    /// Moves, projects, culls, shades, counts tiles.
    pub static DEFORM_PROJECT: DeformProject = {
        name: "deform_project",
        doc: "motion, projection, culling, SH colour and exact tile count of each Gaussian, and the lists of tiles, unsorted",
        local_size: DEFORM_PROJECT_THREADS,
        constants: DeformProjectConstants,
        push: DeformProjectPush,
        buffers: DeformProjectBuffers,
        twin: twin::deform_project,
        arrange: twin::arrange,
        // exp, log2 and sqrt may be off by some units in the last place on a GPU (Vulkan 1.2, table of precision); a tile
        // count may flip where an ellipse touches a tile's first pixel centre.
        tolerance: Tolerance { absolute: 1e-4, relative: 1e-4, flips: 1e-3 },
        bytes: deform_project_bytes,
    }
}

/// Every Gaussian: centre, opacity, tile count (and superpoint when moving); a visible one also scale, rotation, SH, splat; with lists
/// of their own for tiles their pairs.
fn deform_project_bytes(work: &Workload) -> u64 {
    let moving = if work.get("superpoints") > 0 { work.get("blend_bytes").max(4) } else { 0 };
    let keys = work.get("superpoints") * 64;
    work.get("gaussians") * (work.get("mean_bytes") + 4 + 4 + moving + work.get("optional_bytes"))
        + work.get("visible") * (12 + 16 + work.get("sh_bytes") + work.get("splat_bytes"))
        + if work.get("tile_room") > 0 { 8 * work.get("instances") } else { 0 }
        + keys
}

const SH_0: f32 = 0.282_094_8;
const SH_1: f32 = 0.488_602_5;
const SH_2A: f32 = 1.092_548_5;
const SH_2B: f32 = 0.315_391_57;
const SH_2C: f32 = 0.546_274_24;
const SH_3A: f32 = 0.590_043_6;
const SH_3B: f32 = 2.890_611_4;
const SH_3C: f32 = 0.457_045_8;
const SH_3D: f32 = 0.373_176_34;
const SH_3E: f32 = 1.445_305_7;

/// SH basis of degrees 0–3 in direction `d` (unit), the 16 values of `glsl/lib/sh.glsl`.
pub fn sh_basis(d: [f32; 3]) -> [f32; 16] {
    let [x, y, z] = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        SH_0,
        -SH_1 * y,
        SH_1 * z,
        -SH_1 * x,
        SH_2A * x * y,
        -SH_2A * y * z,
        SH_2B * (2.0 * z * z - x * x - y * y),
        -SH_2A * x * z,
        SH_2C * (x * x - y * y),
        -SH_3A * y * (3.0 * xx - yy),
        SH_3B * x * y * z,
        -SH_3C * y * (4.0 * zz - xx - yy),
        SH_3D * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -SH_3C * x * (4.0 * zz - xx - yy),
        SH_3E * z * (xx - yy),
        -SH_3A * x * (xx - 3.0 * yy),
    ]
}

//! Kernel `deform_project`: moves, projects, culls and shades each Gaussian and counts the tiles it reaches.
//!
//! One Gaussian per thread, 256 per workgroup. For each Gaussian of `mean [3][N]` it writes `tile_count[N]` (0 = culled)
//! and, for the visible ones only, `splats`, as `vec4[3N]`: (mean px, l11, l12), (l22, log2 opacity, z, 0), (r, g, b, 0),
//! or packed ([`super::splat`]).
//! Sums: `visible_block[b]` per workgroup and `[block_capacity + b / 256]` above it; `counters` 0 visible, 1–2 instances
//! (64 bits), 4 rejected. `visible_block` and `counters` must be zeroed before.
//!
//! With `NONRIGID` = 1 it adds `nonrigid_offset float[10][N]`, planes dx 3, dq 4 (w,x,y,z), ds 3, to the moved Gaussian:
//! μ + dx, norm(q + dq), max(exp(log_scale) + ds, exp(−30)).
//!
//! Source of the formulas: EWA projection as in 3D Gaussian splatting with gsplat's clamp of the Jacobian; motion of
//! Superpoint Gaussian Splatting. Cholesky form and Cauchy–Binet determinant: see `conic_root`.

use super::ellipse::Ellipse;
use super::frame::Frame;
use super::limits::{COUNT_INSTANCES_HIGH, COUNT_INSTANCES_LOW, COUNT_REJECTED, COUNT_VISIBLE, SCAN_SUPER};
use super::mean_storage;
use super::quaternion::{self, dot};
use super::sh_storage;
use super::splat::{pack_splat, round_conic, splat_words};
use super::twin::{f32_at, group_count, push, spec, struct_at, vec4_at};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall, Workload};

crate::gpu_struct! {
    /// Push constants of [`DEFORM_PROJECT`].
    pub struct DeformProjectPush {
        /// Where the super sums start in `visible_block`: the number of blocks that it has room for.
        pub block_capacity: u32,
    }
}

/// Threads per workgroup = Gaussians per block sum.
pub const DEFORM_PROJECT_THREADS: u32 = 256;
/// `MOTION` of a scene that stands still.
pub const MOTION_STATIC: u32 = 0;
/// `MOTION` of a scene with a pose table `vec4[T][M][2]`: (r, 0), (τ, 0).
pub const MOTION_TABLE: u32 = 1;

/// Moves, projects, culls, shades, counts tiles.
pub static DEFORM_PROJECT: Kernel = Kernel {
    name: "deform_project",
    doc: "motion, projection, culling, SH colour and exact tile count of each Gaussian",
    local_size: DEFORM_PROJECT_THREADS,
    spec: &[
        "SUBGROUP_SIZE",
        "SH_DEGREE",
        "MOTION",
        "NONRIGID",
        "ALPHA_CUT",
        "TILE_CULL",
        "PACKING",
        "SH_STORAGE",
        "MEAN_STORAGE",
    ],
    push: DeformProjectPush::FIELDS,
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("mean", Access::Read, Element::U32),
        Binding::new("log_scale", Access::Read, Element::F32),
        Binding::new("rotation", Access::Read, Element::F32),
        Binding::new("opacity_logit", Access::Read, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Read, Element::U32),
        Binding::new("pose", Access::Read, Element::F32),
        Binding::new("sh_0", Access::Read, Element::U32),
        Binding::new("sh_1", Access::Read, Element::U32),
        Binding::new("sh_2", Access::Read, Element::U32),
        Binding::new("sh_3", Access::Read, Element::U32),
        Binding::new("splats", Access::Write, Element::F32),
        Binding::new("tile_count", Access::Write, Element::U32),
        Binding::new("visible_block", Access::Atomic, Element::U32),
        Binding::new("counters", Access::Atomic, Element::U32),
        Binding::new("nonrigid_offset", Access::Read, Element::F32),
    ],
    twin: deform_project_twin,
    // exp, log2 and sqrt may be off by some units in the last place on a GPU (Vulkan 1.2, table of precision); a tile
    // count may flip where an ellipse touches a tile's first pixel centre.
    tolerance: Tolerance { absolute: 1e-4, relative: 1e-4, flips: 1e-3 },
    bytes: deform_project_bytes,
    spirv: include_bytes!("../../../spirv_cache/deform_project.spv"),
};

/// Every Gaussian: centre, opacity, tile count (and superpoint when moving); a visible one also scale, rotation, SH, splat.
fn deform_project_bytes(work: &Workload) -> u64 {
    let moving = if work.get("superpoints") > 0 { 4 } else { 0 };
    let keys = work.get("superpoints") * 64;
    work.get("gaussians") * (work.get("mean_bytes") + 4 + 4 + moving)
        + work.get("visible") * (12 + 16 + work.get("sh_bytes") + work.get("splat_bytes"))
        + keys
}

const DILATION_PX2: f32 = 0.3;
const ROOT_HALF_LOG2_E: f32 = 0.849_321_8;
const MAX_ABS_MEAN: f32 = 1e15;
const MAX_ABS_LOG_SCALE: f32 = 30.0;
const MAX_ABS_TRANSLATION: f32 = 1e15;
const MAX_ABS_COLOUR: f32 = 1e9;
const MIN_ROTATION_NORM2: f32 = 1e-24;
const MIN_SCALE: f32 = 9.357_623e-14;
const MAX_SCALE: f32 = 1.1e13;

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

/// Specialisation constants.
struct Constants {
    degree: u32,
    motion: u32,
    nonrigid: bool,
    alpha_cut: u32,
    tile_cull: u32,
    packing: u32,
    sh_storage: u32,
    mean_storage: u32,
}

/// What became of a Gaussian.
enum Outcome {
    Culled,
    Rejected,
    Visible { splat: [[f32; 4]; 3], tiles: u32 },
}

fn within(v: [f32; 3], limit: f32) -> bool {
    v.iter().all(|x| x.is_finite() && x.abs() <= limit)
}

/// `[3]` of Gaussian `g` in a plane-major `[3][n]` buffer, from plane `first`.
fn planes(words: &[u32], first: usize, n: usize, g: usize) -> [f32; 3] {
    std::array::from_fn(|c| f32_at(words, (first + c) * n + g))
}

fn add(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn xyz(v: [f32; 4]) -> [f32; 3] {
    [v[0], v[1], v[2]]
}

/// Σ of the SH bands up to `degree`.
fn sh_sum(buffers: &[Vec<u32>], constants: &Constants, n: usize, g: usize, d: [f32; 3]) -> [f32; 3] {
    let basis = sh_basis(d);
    let coefficients = |band: usize, k: usize| -> [f32; 3] {
        std::array::from_fn(|i| {
            sh_storage::coefficient(&buffers[7 + band], constants.sh_storage, band, 3 * k + i, n, g)
        })
    };
    let mut sum = coefficients(0, 0).map(|c| SH_0 * c);
    for band in 1..=constants.degree as usize {
        for k in 0..2 * band + 1 {
            let c = coefficients(band, k);
            sum = add(sum, c.map(|c| basis[band * band + k] * c));
        }
    }
    sum
}

/// Cholesky root (l11, l12, l22) of the conic and the variance along x. See the shader.
fn conic_root(columns: [[f32; 3]; 3], scale: [f32; 3], tangent: [f32; 2], focal: [f32; 2]) -> [f32; 4] {
    let mut m: [[f32; 2]; 3] = std::array::from_fn(|k| {
        std::array::from_fn(|i| scale[k] * focal[i] * (columns[k][i] - tangent[i] * columns[k][2]))
    });
    let longest = m.iter().flatten().fold(1.0_f32, |a, b| a.max(b.abs()));
    let unit_bits = longest.to_bits() & 0x7f80_0000;
    let inverse_unit = f32::from_bits(0x7f00_0000 - unit_bits.min(0x7e80_0000));
    m.iter_mut().flatten().for_each(|v| *v *= inverse_unit);
    let s = scale.map(|v| v * inverse_unit);
    let ray = [tangent[0], tangent[1], 1.0];
    let area = focal[0] * focal[1];
    let minor_12 = area * dot(columns[0], ray) * s[1] * s[2];
    let minor_20 = area * dot(columns[1], ray) * s[2] * s[0];
    let minor_01 = area * dot(columns[2], ray) * s[0] * s[1];
    let dilation = DILATION_PX2 * inverse_unit * inverse_unit;
    let xx = m[0][0] * m[0][0] + m[1][0] * m[1][0] + m[2][0] * m[2][0];
    let xy = m[0][0] * m[0][1] + m[1][0] * m[1][1] + m[2][0] * m[2][1];
    let yy = m[0][1] * m[0][1] + m[1][1] * m[1][1] + m[2][1] * m[2][1];
    let minors = minor_12 * minor_12 + minor_20 * minor_20 + minor_01 * minor_01;
    let det = minors + dilation * (xx + yy) + dilation * dilation;
    let c = yy + dilation;
    let k = ROOT_HALF_LOG2_E * inverse_unit;
    let variance_x = (xx + dilation) / (inverse_unit * inverse_unit);
    [k * (c / det).sqrt(), -k * xy / (c.sqrt() * det.sqrt()), k / c.sqrt(), variance_x]
}

fn reaches_image(e: &Ellipse, variance_x: f32, width: u32) -> bool {
    let reach = (e.threshold().max(0.0) * variance_x).sqrt() / ROOT_HALF_LOG2_E;
    let slack = 1.0 + 1e-4 * (reach + e.mean[0].abs());
    let left_of = e.mean[0] + reach + slack < 0.0;
    let right_of = e.mean[0] - reach - slack > width as f32;
    !left_of && !right_of
}

/// Pose of Gaussian `g` at the frame's time: the unit quaternion of Exp(r), and τ.
fn pose_of(buffers: &[Vec<u32>], frame: &Frame, g: usize) -> Option<([f32; 4], [f32; 3])> {
    let superpoint = buffers[5][g];
    if superpoint >= frame.superpoints {
        return None;
    }
    let key = |k: u32| (2 * (k * frame.superpoints + superpoint)) as usize;
    let (first, second) = (key(frame.first_key), key(frame.second_key));
    let weight = frame.key_weight;
    let lerp = |offset: usize| -> [f32; 3] {
        let (a, b) = (vec4_at(&buffers[6], first + offset), vec4_at(&buffers[6], second + offset));
        std::array::from_fn(|i| a[i] * (1.0 - weight) + b[i] * weight)
    };
    let (r, translation) = (lerp(0), lerp(1));
    if !within(r, MAX_ABS_TRANSLATION) || !within(translation, MAX_ABS_TRANSLATION) {
        return None;
    }
    Some((quaternion::exp(r), translation))
}

/// Unit quaternion and standard deviations of Gaussian `g`; `turn` is its superpoint's rotation.
fn shape_of(buffers: &[Vec<u32>], n: usize, nonrigid: bool, turn: [f32; 4], g: usize) -> Option<([f32; 4], [f32; 3])> {
    let log_s = planes(&buffers[2], 0, n, g);
    let q = vec4_at(&buffers[3], g);
    let norm2 = dot4(q, q);
    if !within(log_s, MAX_ABS_LOG_SCALE) || !norm2.is_finite() || norm2 <= MIN_ROTATION_NORM2 {
        return None;
    }
    let q = quaternion::product(turn, q.map(|v| v / norm2.sqrt()));
    let scale = log_s.map(f32::exp);
    if !nonrigid {
        return Some((q, scale));
    }
    let sum: [f32; 4] = std::array::from_fn(|i| q[i] + f32_at(&buffers[15], (3 + i) * n + g));
    let sum2 = dot4(sum, sum);
    let added = add(scale, planes(&buffers[15], 7, n, g));
    if !sum2.is_finite() || sum2 <= MIN_ROTATION_NORM2 || !within(added, MAX_SCALE) {
        return None;
    }
    Some((sum.map(|v| v / sum2.sqrt()), added.map(|s| s.max(MIN_SCALE))))
}

fn dot4(a: [f32; 4], b: [f32; 4]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

fn project(buffers: &[Vec<u32>], frame: &Frame, constants: &Constants, g: usize) -> Outcome {
    let Constants { motion, nonrigid, packing, .. } = *constants;
    let n = frame.gaussians as usize;
    let canonical = mean_storage::centre(&buffers[1], constants.mean_storage, n, g);
    let logit = f32_at(&buffers[4], g);
    if !within(canonical, MAX_ABS_MEAN) || logit.is_nan() {
        return Outcome::Rejected;
    }
    let (high, low) = (frame.camera_position_high, frame.camera_position_low);
    let mut d: [f32; 3] = std::array::from_fn(|i| (canonical[i] - high[i]) - low[i]);
    let mut turn = [1.0, 0.0, 0.0, 0.0];
    if motion == MOTION_TABLE {
        let Some((rotation, translation)) = pose_of(buffers, frame, g) else { return Outcome::Rejected };
        turn = rotation;
        d = add(d, add(quaternion::displacement(turn, canonical), translation));
    }
    if nonrigid {
        let dx = planes(&buffers[15], 0, n, g);
        if !within(dx, MAX_ABS_TRANSLATION) {
            return Outcome::Rejected;
        }
        d = add(d, dx);
    }
    let rows = [frame.world_to_camera_0, frame.world_to_camera_1, frame.world_to_camera_2].map(xyz);
    let p = rows.map(|row| dot(row, d));
    if !p.iter().all(|v| v.is_finite()) {
        return Outcome::Rejected;
    }
    let in_front = p[2] > high[3];
    let log2_opacity = -(1.0 + (-logit).exp()).log2();
    let mut e = Ellipse { log2_opacity, ..Ellipse::NONE }.with_constants(constants.alpha_cut, constants.tile_cull);
    let bright = e.threshold() > 0.0;
    if !in_front || !bright {
        return Outcome::Culled;
    }

    let Some((q, scale)) = shape_of(buffers, n, nonrigid, turn, g) else { return Outcome::Rejected };
    let columns = quaternion::columns(q).map(|axis| rows.map(|row| dot(row, axis)));
    let slope = [p[0] / p[2], p[1] / p[2]];
    let limit = frame.tan_limit;
    let tangent = [slope[0].max(limit[0]).min(limit[1]), slope[1].max(limit[2]).min(limit[3])];
    let [fx, fy, cx, cy] = frame.intrinsics;
    let root = conic_root(columns, scale.map(|s| s / p[2]), tangent, [fx, fy]);
    e = Ellipse { mean: [fx * slope[0] + cx, fy * slope[1] + cy], l11: root[0], l12: root[1], l22: root[2], ..e };
    let positive = root[0] > 0.0 && root[2] > 0.0;
    if !e.mean.iter().chain(&root[..3]).all(|v| v.is_finite()) || !positive {
        return Outcome::Rejected;
    }
    let (conic, log2_opacity) = round_conic(packing, [e.l11, e.l12, e.l22], log2_opacity);
    e = Ellipse { l11: conic[0], l12: conic[1], l22: conic[2], log2_opacity, ..e };
    let size = frame.size;
    let tiles = if reaches_image(&e, root[3], size[0]) { e.tile_count(size) } else { 0 };
    if tiles == 0 {
        return Outcome::Culled;
    }

    let length = dot(d, d).sqrt();
    let colour = sh_sum(buffers, constants, n, g, d.map(|v| v / length)).map(|s| 0.5 + s);
    if !within(colour, MAX_ABS_COLOUR) {
        return Outcome::Rejected;
    }
    let [r, g, b] = colour.map(|c| c.max(0.0));
    let splat = [[e.mean[0], e.mean[1], e.l11, e.l12], [e.l22, e.log2_opacity, p[2], 0.0], [r, g, b, 0.0]];
    Outcome::Visible { splat, tiles }
}

fn deform_project_twin(call: &mut TwinCall<'_>) {
    let DeformProjectPush { block_capacity } = push(call);
    let frame: Frame = struct_at(&call.buffers[0], 0);
    let constants = Constants {
        degree: spec(call, 1),
        motion: spec(call, 2),
        nonrigid: spec(call, 3) == 1,
        alpha_cut: spec(call, 4),
        tile_cull: spec(call, 5),
        packing: spec(call, 6),
        sh_storage: spec(call, 7),
        mean_storage: spec(call, 8),
    };
    let words = splat_words(constants.packing);
    for group in 0..group_count(call) as usize {
        let first = group * DEFORM_PROJECT_THREADS as usize;
        let last = (first + DEFORM_PROJECT_THREADS as usize).min(frame.gaussians as usize);
        if first >= last {
            continue;
        }
        let (mut visible, mut rejected, mut total) = (0, 0, 0_u32);
        for g in first..last {
            let outcome = project(call.buffers, &frame, &constants, g);
            call.buffers[12][g] = 0;
            match outcome {
                Outcome::Culled => {}
                Outcome::Rejected => rejected += 1,
                Outcome::Visible { splat, tiles } => {
                    let packed = pack_splat(constants.packing, splat);
                    call.buffers[11][words * g..words * (g + 1)].copy_from_slice(&packed[..words]);
                    call.buffers[12][g] = tiles;
                    visible += 1;
                    total += tiles;
                }
            }
        }
        call.buffers[13][group] = visible;
        call.buffers[13][block_capacity as usize + group / SCAN_SUPER as usize] += visible;
        let counters = &mut call.buffers[14];
        counters[COUNT_VISIBLE as usize] += visible;
        let (low, carry) = counters[COUNT_INSTANCES_LOW as usize].overflowing_add(total);
        counters[COUNT_INSTANCES_LOW as usize] = low;
        counters[COUNT_INSTANCES_HIGH as usize] += u32::from(carry);
        counters[COUNT_REJECTED as usize] += rejected;
    }
}

//! Twin of `deform_project`.

use super::super::ellipse::Ellipse;
use super::super::emit_tiles::tiles_of;
use super::super::frame::Frame;
use super::super::limits::{
    COUNT_FAILED, COUNT_INSTANCES_HIGH, COUNT_INSTANCES_LOW, COUNT_LONGEST, COUNT_REJECTED, COUNT_VISIBLE,
    FAILED_INSTANCES, INSTANCE_GAUSSIAN, INSTANCE_QUADRANT_SHIFT, SCAN_SUPER, TILE_PITCH,
};
use super::super::mean_storage;
use super::super::quaternion::{self, dot};
use super::super::sh_storage;
use super::super::splat::{pack_splat, round_opacity, splat_words};
use super::super::superpoint_motion::SuperpointMotion;
use super::super::twin::{f32_at, struct_at, vec4_at};
use super::{
    DEFORM_PROJECT_THREADS, DeformProject, DeformProjectBuffers, DeformProjectConstants, MOTION_TABLE, SH_0, sh_basis,
};
use crate::gpu::interface::Call;
use crate::scene::parameter::{LIFESPAN, Present, SMOOTHING, smoothed};

const DILATION_PX2: f32 = 0.3;
const ROOT_HALF_LOG2_E: f32 = 0.849_321_8;
const HALF_LOG2_E: f32 = 0.721_347_5;
const MAX_ABS_MEAN: f32 = 1e15;
const MAX_ABS_LOG_SCALE: f32 = 30.0;
const MAX_ABS_TRANSLATION: f32 = 1e15;
const MAX_ABS_COLOUR: f32 = 1e9;
const MIN_ROTATION_NORM2: f32 = 1e-24;
const MIN_SCALE: f32 = 9.357_623e-14;
const MAX_SCALE: f32 = 1.1e13;

type Inputs<'a> = DeformProjectBuffers<&'a mut [u32]>;

/// What became of a Gaussian.
enum Outcome {
    Culled,
    Rejected,
    Visible { splat: [[f32; 4]; 3], ellipse: Ellipse },
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
fn sh_sum(b: &Inputs<'_>, constants: &DeformProjectConstants, n: usize, g: usize, d: [f32; 3]) -> [f32; 3] {
    let basis = sh_basis(d);
    let [sh_1, sh_2, sh_3] = [&b.sh_1, &b.sh_2, &b.sh_3].map(|band| band.as_deref().unwrap_or_default());
    let bands: [&[u32]; 4] = [b.sh_0, sh_1, sh_2, sh_3];
    let coefficients = |band: usize, k: usize| -> [f32; 3] {
        std::array::from_fn(|i| sh_storage::coefficient(bands[band], constants.sh_storage, band, 3 * k + i, n, g))
    };
    let mut sum = coefficients(0, 0).map(|c| SH_0 * c);
    for band in 1..=constants.sh_degree as usize {
        for k in 0..2 * band + 1 {
            let c = coefficients(band, k);
            sum = add(sum, c.map(|c| basis[band * band + k] * c));
        }
    }
    sum
}

/// Cholesky root (l11, l12, l22) of the conic, the variance along x, and det(Σ₂ − 0.3·I) / det Σ₂. See the shader.
fn conic_root(columns: [[f32; 3]; 3], scale: [f32; 3], tangent: [f32; 2], focal: [f32; 2]) -> [f32; 5] {
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
    [k * (c / det).sqrt(), -k * xy / (c.sqrt() * det.sqrt()), k / c.sqrt(), variance_x, minors / det]
}

fn reaches_image(e: &Ellipse, variance_x: f32, width: u32) -> bool {
    let reach = (e.threshold().max(0.0) * variance_x).sqrt() / ROOT_HALF_LOG2_E;
    let slack = 1.0 + 1e-4 * (reach + e.mean[0].abs());
    let left_of = e.mean[0] + reach + slack < 0.0;
    let right_of = e.mean[0] - reach - slack > width as f32;
    !left_of && !right_of
}

/// Displacement of Gaussian `g` from `canonical` and its rotation by its superpoints.
fn motion_of(b: &Inputs<'_>, frame: &Frame, slots: u32, canonical: [f32; 3], g: usize) -> Option<([f32; 3], [f32; 4])> {
    let motion = SuperpointMotion {
        superpoint_of_gaussian: b.superpoint_of_gaussian.as_deref().unwrap_or_default(),
        pose: b.pose.as_deref()?,
        slots,
        blend_index: b.blend_index.as_deref().unwrap_or_default(),
        blend_weight: b.blend_weight.as_deref().unwrap_or_default(),
    };
    motion.displacement(frame, g, canonical)
}

/// Number `k` of an optional parameter, where there is one.
fn optional(
    b: &Inputs<'_>,
    constants: &DeformProjectConstants,
    [parameter, k]: [usize; 2],
    n: usize,
    g: usize,
) -> Option<f32> {
    let (present, values) = (Present(constants.optional), b.optional.as_deref()?);
    present.has(parameter).then(|| f32_at(values, (present.planes_before(parameter) as usize + k) * n + g))
}

/// Log2 of the share of the opacity that the lifespan leaves at the frame's time.
fn log2_share(b: &Inputs<'_>, constants: &DeformProjectConstants, frame: &Frame, n: usize, g: usize) -> f32 {
    let value = |k: usize| optional(b, constants, [LIFESPAN, k], n, g);
    let (Some(middle), Some(log_length)) = (value(0), value(1)) else { return 0.0 };
    let x = (frame.time - middle) * (-log_length).exp();
    -HALF_LOG2_E * x * x
}

/// Standard deviations blurred by `sigma`, and log2 of the share of the opacity that this leaves; `None` when it is unusable.
fn blurred(scale: [f32; 3], sigma: f32) -> Option<([f32; 3], f32)> {
    let (wide, share) = smoothed(scale.map(f64::from), sigma.into());
    (sigma.abs() <= MAX_SCALE).then_some((wide.map(|s| s as f32), share.log2() as f32))
}

/// Unit quaternion and standard deviations of Gaussian `g`; `turn` is its superpoint's rotation.
fn shape_of(
    b: &Inputs<'_>,
    n: usize,
    offset: Option<&[u32]>,
    turn: [f32; 4],
    g: usize,
) -> Option<([f32; 4], [f32; 3])> {
    let log_s = planes(b.log_scale, 0, n, g);
    let q = vec4_at(b.rotation, g);
    let norm2 = dot4(q, q);
    if !within(log_s, MAX_ABS_LOG_SCALE) || !norm2.is_finite() || norm2 <= MIN_ROTATION_NORM2 {
        return None;
    }
    let q = quaternion::product(turn, q.map(|v| v / norm2.sqrt()));
    let scale = log_s.map(f32::exp);
    let Some(offset) = offset else { return Some((q, scale)) };
    let sum: [f32; 4] = std::array::from_fn(|i| q[i] + f32_at(offset, (3 + i) * n + g));
    let sum2 = dot4(sum, sum);
    let added = add(scale, planes(offset, 7, n, g));
    if !sum2.is_finite() || sum2 <= MIN_ROTATION_NORM2 || !within(added, MAX_SCALE) {
        return None;
    }
    Some((sum.map(|v| v / sum2.sqrt()), added.map(|s| s.max(MIN_SCALE))))
}

fn dot4(a: [f32; 4], b: [f32; 4]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

fn project(b: &Inputs<'_>, frame: &Frame, constants: &DeformProjectConstants, g: usize) -> Outcome {
    let DeformProjectConstants { motion, packing, .. } = *constants;
    let offset = b.nonrigid_offset.as_deref().filter(|_| constants.nonrigid == 1);
    let n = frame.gaussians as usize;
    let canonical = mean_storage::centre(b.mean, constants.mean_storage, n, g);
    let logit = f32_at(b.opacity_logit, g);
    if !within(canonical, MAX_ABS_MEAN) || logit.is_nan() {
        return Outcome::Rejected;
    }
    let (high, low) = (frame.camera_position_high, frame.camera_position_low);
    let mut d: [f32; 3] = std::array::from_fn(|i| (canonical[i] - high[i]) - low[i]);
    let mut turn = [1.0, 0.0, 0.0, 0.0];
    if motion == MOTION_TABLE {
        let moved = motion_of(b, frame, constants.blend, canonical, g);
        let Some((displacement, rotation)) = moved else { return Outcome::Rejected };
        turn = rotation;
        d = add(d, displacement);
    }
    if let Some(offset) = offset {
        let dx = planes(offset, 0, n, g);
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
    let in_front = p[2] > frame.near;
    let log2_opacity = -(1.0 + (-logit).exp()).log2() + log2_share(b, constants, frame, n, g);
    let e = Ellipse { log2_opacity, ..Ellipse::NONE }.with_constants(constants.alpha_cut, constants.tile_cull);
    let bright = e.threshold() > 0.0;
    if !in_front || !bright {
        return Outcome::Culled;
    }

    let Some((q, scale)) = shape_of(b, n, offset, turn, g) else { return Outcome::Rejected };
    let sigma = optional(b, constants, [SMOOTHING, 0], n, g);
    let shape = sigma.map_or(Some((scale, 0.0)), |sigma| blurred(scale, sigma));
    let Some((scale, log2_share)) = shape else { return Outcome::Rejected };
    let log2_opacity = log2_opacity + log2_share;
    let columns = quaternion::columns(q).map(|axis| rows.map(|row| dot(row, axis)));
    let slope = [p[0] / p[2], p[1] / p[2]];
    let limit = frame.tan_limit;
    let tangent = [slope[0].max(limit[0]).min(limit[1]), slope[1].max(limit[2]).min(limit[3])];
    let [fx, fy, cx, cy] = frame.intrinsics;
    let root = conic_root(columns, scale.map(|s| s / p[2]), tangent, [fx, fy]);
    let log2_opacity = if constants.antialiased == 1 { log2_opacity + 0.5 * root[4].log2() } else { log2_opacity };
    let mut e =
        Ellipse { mean: [fx * slope[0] + cx, fy * slope[1] + cy], l11: root[0], l12: root[1], l22: root[2], ..e };
    let positive = root[0] > 0.0 && root[2] > 0.0;
    if !e.mean.iter().chain(&root[..3]).all(|v| v.is_finite()) || !positive {
        return Outcome::Rejected;
    }
    e = Ellipse { log2_opacity: round_opacity(packing, log2_opacity), ..e };
    let rows = if e.threshold() > 0.0 && reaches_image(&e, root[3], frame.size[0]) {
        e.tile_row_range(frame.size)
    } else {
        [0, 0]
    };
    if rows[0] >= rows[1] {
        return Outcome::Culled;
    }

    let length = dot(d, d).sqrt();
    let colour = sh_sum(b, constants, n, g, d.map(|v| v / length)).map(|s| 0.5 + s);
    if !within(colour, MAX_ABS_COLOUR) {
        return Outcome::Rejected;
    }
    let colour = colour.map(|c| c.max(0.0));
    let splat = [
        [e.mean[0], e.mean[1], e.l11, e.l12],
        [e.l22, e.log2_opacity, p[2], 0.0],
        [colour[0], colour[1], colour[2], 0.0],
    ];
    Outcome::Visible { splat, ellipse: e }
}

/// Appends a Gaussian to the list of each tile that it reaches; how many these are.
fn append(b: &mut Inputs<'_>, frame: &Frame, e: &Ellipse, g: usize, z: f32) -> u32 {
    let room = frame.tile_room;
    let tiles = tiles_of(e, u32::MAX, frame);
    for &(tile, quadrants) in &tiles {
        let count = &mut b.tile_end[tile * TILE_PITCH as usize];
        if let Some(pairs) = b.pairs.as_deref_mut().filter(|_| *count < room) {
            let at = 2 * (tile as u32 * room + *count) as usize;
            pairs[at..at + 2].copy_from_slice(&[z.to_bits(), g as u32 | quadrants << INSTANCE_QUADRANT_SHIFT]);
        }
        *count += 1;
        if *count > room / 4 * 3 {
            let longest = &mut b.counters[COUNT_LONGEST as usize];
            *longest = (*longest).max(*count);
            b.counters[COUNT_FAILED as usize] |= if *count > room { FAILED_INSTANCES } else { 0 };
        }
    }
    tiles.len() as u32
}

/// Sorts the pairs of each tile by Gaussian: they come in whatever order atomics had. Depths and quadrants, which follow from numbers
/// that may be off in the last place, become whether the depth is the splat's.
pub(super) fn arrange(buffers: &mut [Vec<u32>]) {
    let [frame, _, _, _, _, _, _, _, _, _, _, splats, tile_count, _, _, _, _, _, _, ends, pairs] = buffers else {
        return;
    };
    let frame: Frame = struct_at(frame, 0);
    if pairs.is_empty() || frame.tile_room == 0 {
        return;
    }
    let words = splats.len() / tile_count.len().max(1);
    for (list, count) in
        pairs.chunks_exact_mut(2 * frame.tile_room as usize).zip(ends.iter().step_by(TILE_PITCH as usize))
    {
        let mut sorted: Vec<[u32; 2]> = list.chunks_exact(2).take(*count as usize).map(|p| [p[0], p[1]]).collect();
        for [depth, instance] in &mut sorted {
            *instance &= INSTANCE_GAUSSIAN;
            let own = splats.get(words * *instance as usize + 6).is_some_and(|z| z == depth);
            *depth = own.into();
        }
        sorted.sort_unstable_by_key(|[_, gaussian]| *gaussian);
        list[..2 * sorted.len()].copy_from_slice(sorted.as_flattened());
    }
}

/// Counts a Gaussian for each tile that it reaches; how many these are.
fn count_tiles(tile_change: &mut [u32], frame: &Frame, e: &Ellipse) -> u32 {
    let rows = e.tile_row_range(frame.size);
    let mut count = 0;
    for row in rows[0]..rows[1] {
        let [first, end] = e.tile_columns_of_row(row, frame.size);
        if first < end {
            let at = |column: u32| ((row * frame.tiles[0] + column) * TILE_PITCH) as usize;
            tile_change[at(first)] = tile_change[at(first)].wrapping_add(1);
            tile_change[at(end)] = tile_change[at(end)].wrapping_sub(1);
            count += end - first;
        }
    }
    count
}

pub(super) fn deform_project(call: Call<'_, DeformProject>) {
    let groups = call.group_count() as usize;
    let Call { constants, push, buffers: mut b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let words = splat_words(constants.packing);
    for group in 0..groups {
        let first = group * DEFORM_PROJECT_THREADS as usize;
        let last = (first + DEFORM_PROJECT_THREADS as usize).min(frame.gaussians as usize);
        if first >= last {
            continue;
        }
        let (mut visible, mut rejected, mut total) = (0, 0, 0_u32);
        for g in first..last {
            let outcome = project(&b, &frame, &constants, g);
            b.tile_count[g] = 0;
            match outcome {
                Outcome::Culled => {}
                Outcome::Rejected => rejected += 1,
                Outcome::Visible { splat, ellipse } => {
                    let packed = pack_splat(constants.packing, splat);
                    b.splats[words * g..words * (g + 1)].copy_from_slice(&packed[..words]);
                    let tiles = match constants.lists {
                        0 => count_tiles(b.tile_end, &frame, &ellipse),
                        _ => append(&mut b, &frame, &ellipse, g, splat[1][2]),
                    };
                    b.tile_count[g] = tiles;
                    visible += u32::from(tiles > 0);
                    total += tiles;
                }
            }
        }
        b.instance_block[group] = total;
        b.instance_block[push.block_capacity as usize + group / SCAN_SUPER as usize] += total;
        b.counters[COUNT_VISIBLE as usize] += visible;
        let (low, carry) = b.counters[COUNT_INSTANCES_LOW as usize].overflowing_add(total);
        b.counters[COUNT_INSTANCES_LOW as usize] = low;
        b.counters[COUNT_INSTANCES_HIGH as usize] += u32::from(carry);
        b.counters[COUNT_REJECTED as usize] += rejected;
    }
}

// Moves, projects, culls and shades each Gaussian: one per thread. Writes its splat and its exact tile count; culled ones
// cost as few reads as the test that culls them needs, and SH coefficients are read for survivors only.
//
// Formulas (engine::reference holds the same in f64):
//   mean(t) = Exp(r) mean + tau, R(t) = Exp(r) R(q / |q|), (r, tau) interpolated between two keys;
//   cov = J W R S S R' W' J' + 0.3 I with J at the clamped tangents; colour = max(0, 0.5 + sum of SH), not rotated.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 1) const uint SH_DEGREE = 3;
layout(constant_id = 2) const uint MOTION = 0; // 0 static, 1 pose table

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/limits.glsl"
#include "lib/ellipse.glsl"
#include "lib/quaternion.glsl"
#include "lib/sh.glsl"

layout(std430, set = 0, binding = 1) readonly buffer MeanBlock { float mean[]; };
layout(std430, set = 0, binding = 2) readonly buffer LogScaleBlock { float log_scale[]; };
layout(std430, set = 0, binding = 3) readonly buffer RotationBlock { vec4 rotation[]; };
layout(std430, set = 0, binding = 4) readonly buffer OpacityLogitBlock { float opacity_logit[]; };
layout(std430, set = 0, binding = 5) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 6) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 7) readonly buffer Sh0Block { float sh_0[]; };
layout(std430, set = 0, binding = 8) readonly buffer Sh1Block { float sh_1[]; };
layout(std430, set = 0, binding = 9) readonly buffer Sh2Block { float sh_2[]; };
layout(std430, set = 0, binding = 10) readonly buffer Sh3Block { float sh_3[]; };
layout(std430, set = 0, binding = 11) writeonly buffer SplatsBlock { vec4 splats[]; };
layout(std430, set = 0, binding = 12) writeonly buffer TileCountBlock { uint tile_count[]; };
layout(std430, set = 0, binding = 13) buffer VisibleBlockBlock { uint visible_block[]; };
layout(std430, set = 0, binding = 14) buffer CountersBlock { uint counters[]; };

layout(push_constant) uniform Push { uint block_capacity; } push;

const float DILATION_PX2 = 0.3;                  // added to the diagonal of the 2-D covariance
const float ROOT_HALF_LOG2_E = 0.8493218002880191; // sqrt(log2(e) / 2), folded into the Cholesky factor
const float MAX_ABS_MEAN = 1e15;                 // as scene::gaussians: beyond these f32 squares overflow
const float MAX_ABS_LOG_SCALE = 30.0;
const float MAX_ABS_TRANSLATION = 1e15;
const float MAX_ABS_COLOUR = 1e9;
const float MIN_ROTATION_NORM2 = 1e-24;

const uint CULLED = 0u;
const uint REJECTED = 1u;
const uint VISIBLE = 2u;

shared uint subgroup_flags[64]; // visible + 2^16 rejected
shared uint subgroup_tiles[64];

// By bits: a compiler may assume that comparisons never see NaN.
bool is_finite(float x) {
    return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u;
}

bool is_finite(vec3 v) {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

bool within(vec3 v, float limit) {
    return is_finite(v) && abs(v.x) <= limit && abs(v.y) <= limit && abs(v.z) <= limit;
}

vec3 sh_coefficient_0(uint g, uint n) {
    return vec3(sh_0[g], sh_0[n + g], sh_0[2u * n + g]);
}

// Sum of the SH bands up to SH_DEGREE in direction d (unit).
vec3 sh_sum(uint g, uint n, vec3 d) {
    vec3 sum = SH_0 * sh_coefficient_0(g, n);
    uint degree = SH_DEGREE;
    if (degree >= 1u) {
        float b[3];
        sh_band_1(d, b);
        for (uint k = 0u; k < 3u; k++) {
            sum += b[k] * vec3(sh_1[(3u * k) * n + g], sh_1[(3u * k + 1u) * n + g], sh_1[(3u * k + 2u) * n + g]);
        }
    }
    if (degree >= 2u) {
        float b[5];
        sh_band_2(d, b);
        for (uint k = 0u; k < 5u; k++) {
            sum += b[k] * vec3(sh_2[(3u * k) * n + g], sh_2[(3u * k + 1u) * n + g], sh_2[(3u * k + 2u) * n + g]);
        }
    }
    if (degree >= 3u) {
        float b[7];
        sh_band_3(d, b);
        for (uint k = 0u; k < 7u; k++) {
            sum += b[k] * vec3(sh_3[(3u * k) * n + g], sh_3[(3u * k + 1u) * n + g], sh_3[(3u * k + 2u) * n + g]);
        }
    }
    return sum;
}

// Lower triangle of the inverse 2-D covariance's root, (l11, l12, l22) with u = l11 dx + l12 dy, v = l22 dy, and the
// variance along x in `.w`. column_k: columns of W R(t); scale: standard deviations / z; tangent: clamped x/z, y/z.
//
// det(M M') is the sum of the squared 2x2 minors of M = J W R S (Cauchy-Binet): nothing cancels, so needles keep their
// width. A minor of J W R is f_x f_y / z^2 times the component of (x/z, y/z, 1) along the remaining axis. Everything is
// computed in units of 2^k px (`unit`), so that a 1e13 px Gaussian does not overflow.
vec4 conic_root(vec3 column_0, vec3 column_1, vec3 column_2, vec3 scale, vec2 tangent, vec2 focal) {
    vec2 m0 = scale.x * focal * (column_0.xy - tangent * column_0.z);
    vec2 m1 = scale.y * focal * (column_1.xy - tangent * column_1.z);
    vec2 m2 = scale.z * focal * (column_2.xy - tangent * column_2.z);
    vec2 longest = max(abs(m0), max(abs(m1), abs(m2)));
    uint unit_bits = floatBitsToUint(max(1.0, max(longest.x, longest.y))) & 0x7f800000u;
    float inverse_unit = uintBitsToFloat(0x7f000000u - min(unit_bits, 0x7e800000u));
    m0 *= inverse_unit;
    m1 *= inverse_unit;
    m2 *= inverse_unit;
    vec3 s = scale * inverse_unit;
    vec3 ray = vec3(tangent, 1.0);
    float area = focal.x * focal.y;
    float minor_12 = area * dot(column_0, ray) * s.y * s.z;
    float minor_20 = area * dot(column_1, ray) * s.z * s.x;
    float minor_01 = area * dot(column_2, ray) * s.x * s.y;
    float dilation = DILATION_PX2 * inverse_unit * inverse_unit;
    float xx = m0.x * m0.x + m1.x * m1.x + m2.x * m2.x;
    float xy = m0.x * m0.y + m1.x * m1.y + m2.x * m2.y;
    float yy = m0.y * m0.y + m1.y * m1.y + m2.y * m2.y;
    float minors = minor_12 * minor_12 + minor_20 * minor_20 + minor_01 * minor_01;
    float det = minors + dilation * (xx + yy) + dilation * dilation;
    float c = yy + dilation;
    float k = ROOT_HALF_LOG2_E * inverse_unit;
    float variance_x = (xx + dilation) / (inverse_unit * inverse_unit);
    return vec4(k * sqrt(c / det), -k * xy / (sqrt(c) * sqrt(det)), k / sqrt(c), variance_x);
}

// A conservative test of the footprint's horizontal extent against the image; the vertical one is implied by the tile rows.
bool reaches_image(Ellipse e, float variance_x) {
    float reach = sqrt(max(ellipse_threshold(e), 0.0) * variance_x) / ROOT_HALF_LOG2_E;
    float slack = 1.0 + 1e-4 * (reach + abs(e.mean.x));
    return !(e.mean.x + reach + slack < 0.0) && !(e.mean.x - reach - slack > float(frame.size.x));
}

// Processes Gaussian g; the reads come in the order in which the tests need them.
uint project(uint g, uint n, out uint tiles) {
    tiles = 0u;
    vec3 canonical = vec3(mean[g], mean[n + g], mean[2u * n + g]);
    float logit = opacity_logit[g];
    bool logit_is_nan = (floatBitsToUint(logit) & 0x7fffffffu) > 0x7f800000u;
    if (!within(canonical, MAX_ABS_MEAN) || logit_is_nan) {
        return REJECTED;
    }
    // Camera-relative, in two parts: exact for a camera and a Gaussian that share a large offset from the origin.
    precise vec3 d = (canonical - frame.camera_position_high.xyz) - frame.camera_position_low.xyz;
    vec4 turn = vec4(1.0, 0.0, 0.0, 0.0);
    uint motion = MOTION;
    if (motion == 1u) {
        uint superpoint = superpoint_of_gaussian[g];
        if (superpoint >= frame.counts.y) {
            return REJECTED;
        }
        uint first = 2u * (frame.counts.z * frame.counts.y + superpoint);
        uint second = 2u * (frame.counts.w * frame.counts.y + superpoint);
        float weight = frame.camera_position_low.w;
        vec3 r = pose[first].xyz * (1.0 - weight) + pose[second].xyz * weight;
        vec3 translation = pose[first + 1u].xyz * (1.0 - weight) + pose[second + 1u].xyz * weight;
        if (!within(r, MAX_ABS_TRANSLATION) || !within(translation, MAX_ABS_TRANSLATION)) {
            return REJECTED;
        }
        turn = quaternion_exp(r);
        d += quaternion_displacement(turn, canonical) + translation;
    }
    vec3 p = vec3(dot(frame.world_to_camera_0.xyz, d), dot(frame.world_to_camera_1.xyz, d),
                  dot(frame.world_to_camera_2.xyz, d));
    if (!is_finite(p)) {
        return REJECTED;
    }
    if (!(p.z > frame.camera_position_high.w)) {
        return CULLED;
    }
    Ellipse e;
    e.log2_opacity = -log2(1.0 + exp(-logit));
    if (!(ellipse_threshold(e) > 0.0)) {
        return CULLED;
    }

    vec3 log_s = vec3(log_scale[g], log_scale[n + g], log_scale[2u * n + g]);
    vec4 q = rotation[g];
    float norm2 = dot(q, q);
    if (!within(log_s, MAX_ABS_LOG_SCALE) || !is_finite(norm2) || !(norm2 > MIN_ROTATION_NORM2)) {
        return REJECTED;
    }
    q = quaternion_product(turn, q / sqrt(norm2));
    vec3 axis_0;
    vec3 axis_1;
    vec3 axis_2;
    quaternion_columns(q, axis_0, axis_1, axis_2);
    mat3 rows = mat3(frame.world_to_camera_0.xyz, frame.world_to_camera_1.xyz, frame.world_to_camera_2.xyz);
    vec2 slope = p.xy / p.z;
    vec2 tangent = min(max(slope, frame.tan_limit.xz), frame.tan_limit.yw);
    // `v * rows` is the product of the matrix with these rows by v.
    vec4 root = conic_root(axis_0 * rows, axis_1 * rows, axis_2 * rows, exp(log_s) / p.z, tangent, frame.intrinsics.xy);
    e.mean = frame.intrinsics.xy * slope + frame.intrinsics.zw;
    e.l11 = root.x;
    e.l12 = root.y;
    e.l22 = root.z;
    if (!is_finite(e.mean.x) || !is_finite(e.mean.y) || !is_finite(root.xyz) || !(root.x > 0.0) || !(root.z > 0.0)) {
        return REJECTED;
    }
    if (reaches_image(e, root.w)) {
        tiles = ellipse_tile_count(e, frame.size.xy);
    }
    if (tiles == 0u) {
        return CULLED;
    }

    vec3 colour = 0.5 + sh_sum(g, n, d / sqrt(dot(d, d)));
    if (!within(colour, MAX_ABS_COLOUR)) {
        tiles = 0u;
        return REJECTED;
    }
    splats[3u * g] = vec4(e.mean, e.l11, e.l12);
    splats[3u * g + 1u] = vec4(e.l22, e.log2_opacity, p.z, 0.0);
    splats[3u * g + 2u] = vec4(max(colour, vec3(0.0)), 0.0);
    return VISIBLE;
}

void main() {
    uint group = workgroup_index();
    uint g = group * 256u + gl_LocalInvocationIndex;
    uint n = frame.counts.x;
    uint tiles = 0u;
    uint outcome = CULLED;
    if (g < n) {
        outcome = project(g, n, tiles);
        tile_count[g] = tiles;
    }

    uint flags = subgroupAdd(outcome == VISIBLE ? 1u : outcome == REJECTED ? 0x10000u : 0u);
    uint tiles_of_subgroup = subgroupAdd(tiles);
    if (gl_SubgroupInvocationID == 0u) {
        subgroup_flags[gl_SubgroupID] = flags;
        subgroup_tiles[gl_SubgroupID] = tiles_of_subgroup;
    }
    barrier();
    if (gl_LocalInvocationIndex == 0u && group * 256u < n) {
        uint size = SUBGROUP_SIZE;
        uint subgroups = 256u / size;
        uint total_flags = 0u;
        uint total_tiles = 0u; // at most 256 Gaussians x 2^20 tiles
        for (uint i = 0u; i < subgroups; i++) {
            total_flags += subgroup_flags[i];
            total_tiles += subgroup_tiles[i];
        }
        uint visible = total_flags & 0xffffu;
        uint rejected = total_flags >> 16u;
        visible_block[group] = visible;
        if (visible > 0u) {
            atomicAdd(visible_block[push.block_capacity + group / SCAN_SUPER], visible);
            atomicAdd(counters[COUNT_VISIBLE], visible);
            uint before = atomicAdd(counters[COUNT_INSTANCES_LOW], total_tiles);
            if (before + total_tiles < before) {
                atomicAdd(counters[COUNT_INSTANCES_HIGH], 1u);
            }
        }
        if (rejected > 0u) {
            atomicAdd(counters[COUNT_REJECTED], rejected);
        }
    }
}

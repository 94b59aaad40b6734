// Moves, projects, culls and shades each Gaussian: one per thread. Writes its splat and its exact tile count, and counts it for
// each tile that it reaches, or, with LISTS, appends it to their lists (lib/tile_lists.glsl), each of which has room of its own; culled ones cost as few reads as the test that culls them needs, and SH coefficients are read for
// survivors only.
//
// Formulas (engine::reference holds the same in f64):
//   mean(t) = Exp(r) mean + tau, R(t) = Exp(r) R(q / |q|), (r, tau) interpolated between two keys;
//   with soft superpoints: weighted means of these over K superpoints (lib/superpoint_motion.glsl);
//   with non-rigid offsets: mean(t) + dx, norm(Exp(r) q / |q| + dq), exp(log_scale) + ds;
//   cov = J W R S S R' W' J' + 0.3 I with J at the clamped tangents; opacity, where antialiased, times the root of
//   det(cov - 0.3 I) / det(cov); with a smoothing, S'S + smoothing^2 for S'S, and the integral stays; colour = max(0, 0.5 + sum of SH), not rotated.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 256) in;
layout(constant_id = 1) const uint SH_DEGREE = 3;
layout(constant_id = 2) const uint MOTION = 0; // 0 static, 1 pose table
layout(constant_id = 3) const uint NONRIGID = 0; // 1: nonrigid_offset is added
layout(constant_id = 4) const uint ALPHA_CUT = 0; // these two: see lib/ellipse.glsl
layout(constant_id = 5) const uint TILE_CULL = 0;
layout(constant_id = 6) const uint PACKING = 0;    // see lib/splat.glsl
layout(constant_id = 7) const uint SH_STORAGE = 0; // 0 f32, 1 f16, 2 u8 with a range per plane (band 0: f16)
layout(constant_id = 8) const uint MEAN_STORAGE = 0; // 0 f32, 1 unorm16 with a range per coordinate
layout(constant_id = 9) const uint OPTIONAL = 0; // HAS_* of the optional parameters
layout(constant_id = 10) const uint BLEND = 0; // see lib/superpoint_motion.glsl
layout(constant_id = 11) const uint ANTIALIASED = 0; // 1: splats keep their weight where they are wider than the Gaussian
layout(constant_id = 12) const uint LISTS = 0; // 1: Gaussians are appended to the tile lists

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/subgroup.glsl"
#include "lib/limits.glsl"
#include "lib/ellipse.glsl"
#include "lib/splat.glsl"
#include "lib/quaternion.glsl"
#include "lib/sh.glsl"
#include "lib/projection.glsl"
#include "lib/parameters.glsl"
#include "lib/lifespan.glsl"
#include "lib/smoothing.glsl"

layout(std430, set = 0, binding = 1) readonly buffer MeanBlock { uint mean[]; };
layout(std430, set = 0, binding = 2) readonly buffer LogScaleBlock { float log_scale[]; };
layout(std430, set = 0, binding = 3) readonly buffer RotationBlock { vec4 rotation[]; };
layout(std430, set = 0, binding = 4) readonly buffer OpacityLogitBlock { float opacity_logit[]; };
layout(std430, set = 0, binding = 5) readonly buffer SuperpointOfGaussianBlock { uint superpoint_of_gaussian[]; };
layout(std430, set = 0, binding = 6) readonly buffer PoseBlock { vec4 pose[]; };
layout(std430, set = 0, binding = 7) readonly buffer Sh0Block { uint sh_0[]; };
layout(std430, set = 0, binding = 8) readonly buffer Sh1Block { uint sh_1[]; };
layout(std430, set = 0, binding = 9) readonly buffer Sh2Block { uint sh_2[]; };
layout(std430, set = 0, binding = 10) readonly buffer Sh3Block { uint sh_3[]; };
layout(std430, set = 0, binding = 11) coherent buffer SplatsBlock { uvec4 splats[]; };
layout(std430, set = 0, binding = 12) writeonly buffer TileCountBlock { uint tile_count[]; };
layout(std430, set = 0, binding = 13) buffer InstanceBlockBlock { uint instance_block[]; };
layout(std430, set = 0, binding = 14) buffer CountersBlock { uint counters[]; };
layout(std430, set = 0, binding = 15) readonly buffer NonrigidOffsetBlock { float nonrigid_offset[]; };
layout(std430, set = 0, binding = 16) readonly buffer OptionalBlock { float optional[]; };
layout(std430, set = 0, binding = 17) readonly buffer BlendIndexBlock { uint blend_index[]; };
layout(std430, set = 0, binding = 18) readonly buffer BlendWeightBlock { float blend_weight[]; };
layout(std430, set = 0, binding = 19) buffer TileEndBlock { uint tile_end[]; };
layout(std430, set = 0, binding = 20) writeonly buffer PairsBlock { uvec2 pairs[]; };

#include "lib/place.glsl"

layout(push_constant) uniform Push { uint block_capacity; } push;

const uint CULLED = 0u;
const uint REJECTED = 1u;
const uint VISIBLE = 2u;

uvec2 room_of_list(uint tile) {
    return uvec2(tile * frame.tile_room, tile * frame.tile_room + frame.tile_room);
}

// The frame fails where a list has too little room; how long the longest is the host hears before that.
void put(uint count, uvec2 room, uint depth, uint instance, uint slot) {
    uint at = room.x + count;
    if (at < room.y) {
        pairs[at] = uvec2(depth, instance);
    }
    if (count >= frame.tile_room / 4u * 3u) {
        atomicMax(counters[COUNT_LONGEST], count + 1u);
        if (at >= room.y) {
            atomicOr(counters[COUNT_FAILED], FAILED_INSTANCES);
        }
    }
}

#include "lib/tile_lists.glsl"

shared uint subgroup_flags[64]; // visible + 2^16 rejected
shared uint subgroup_tiles[64];

// Coefficients of the planes 3k, 3k + 1, 3k + 2 of a band of `planes` planes. Storage: f32, one word per plane; f16, two
// planes per word, the last one maybe half empty; u8, four planes per word, then low and step of each plane.
#define SH_COEFFICIENT(NAME, BUFFER)                                                                       \
    vec3 NAME(uint k, uint g, uint n, uint planes, uint storage) {                                         \
        vec3 c;                                                                                            \
        for (uint i = 0u; i < 3u; i++) {                                                                   \
            uint p = 3u * k + i;                                                                           \
            if (storage == 0u) {                                                                           \
                c[i] = uintBitsToFloat(BUFFER[p * n + g]);                                                 \
            } else if (storage == 1u) {                                                                    \
                vec2 pair = unpackHalf2x16(BUFFER[(p / 2u) * n + g]);                                      \
                c[i] = (p & 1u) == 0u ? pair.x : pair.y;                                                   \
            } else {                                                                                       \
                uint range = ((planes + 3u) / 4u) * n + 2u * p;                                            \
                float level = float((BUFFER[(p / 4u) * n + g] >> (8u * (p & 3u))) & 255u);                 \
                c[i] = uintBitsToFloat(BUFFER[range]) + level * uintBitsToFloat(BUFFER[range + 1u]);       \
            }                                                                                              \
        }                                                                                                  \
        return c;                                                                                          \
    }

SH_COEFFICIENT(sh_coefficient_0, sh_0)
SH_COEFFICIENT(sh_coefficient_1, sh_1)
SH_COEFFICIENT(sh_coefficient_2, sh_2)
SH_COEFFICIENT(sh_coefficient_3, sh_3)

// Sum of the SH bands up to SH_DEGREE in direction d (unit).
vec3 sh_sum(uint g, uint n, vec3 d) {
    uint degree = SH_DEGREE;
    uint storage = SH_STORAGE;
    vec3 sum = SH_0 * sh_coefficient_0(0u, g, n, 3u, min(storage, 1u));
    if (degree >= 1u) {
        float b[3];
        sh_band_1(d, b);
        for (uint k = 0u; k < 3u; k++) {
            sum += b[k] * sh_coefficient_1(k, g, n, 9u, storage);
        }
    }
    if (degree >= 2u) {
        float b[5];
        sh_band_2(d, b);
        for (uint k = 0u; k < 5u; k++) {
            sum += b[k] * sh_coefficient_2(k, g, n, 15u, storage);
        }
    }
    if (degree >= 3u) {
        float b[7];
        sh_band_3(d, b);
        for (uint k = 0u; k < 7u; k++) {
            sum += b[k] * sh_coefficient_3(k, g, n, 21u, storage);
        }
    }
    return sum;
}

// Lower triangle of the inverse 2-D covariance's root, (l11, l12, l22) with u = l11 dx + l12 dy, v = l22 dy, and the
// variance along x in `.w`.
vec4 conic_root(Footprint f) {
    return vec4(footprint_root(f, ROOT_HALF_LOG2_E * f.inverse_unit),
                (f.xx + f.dilation) / (f.inverse_unit * f.inverse_unit));
}

// A conservative test of the footprint's horizontal extent against the image; the vertical one is implied by the tile rows.
bool reaches_image(Ellipse e, float variance_x) {
    float reach = sqrt(max(ellipse_threshold(e), 0.0) * variance_x) / ROOT_HALF_LOG2_E;
    float slack = 1.0 + 1e-4 * (reach + abs(e.mean.x));
    return !(e.mean.x + reach + slack < 0.0) && !(e.mean.x - reach - slack > float(frame.size.x));
}

// Centre of Gaussian g. unorm16: x and y in one word, z in half a word, then low and step of each coordinate; level 65535
// stands for NaN.
vec3 read_mean(uint g, uint n) {
    uint storage = MEAN_STORAGE;
    if (storage == 0u) {
        return uintBitsToFloat(uvec3(mean[g], mean[n + g], mean[2u * n + g]));
    }
    uint xy = mean[g];
    uvec3 level = uvec3(xy & 0xffffu, xy >> 16u, mean[n + g / 2u] >> (16u * (g & 1u)) & 0xffffu);
    uint range = n + (n + 1u) / 2u;
    vec3 low = uintBitsToFloat(uvec3(mean[range], mean[range + 2u], mean[range + 4u]));
    vec3 step = uintBitsToFloat(uvec3(mean[range + 1u], mean[range + 3u], mean[range + 5u]));
    return level.x == 65535u ? vec3(uintBitsToFloat(0x7fc00000u)) : low + vec3(level) * step;
}

// Camera space: the centre relative to the camera in world axes (d) and in the camera's (p).
bool place_centre(uint g, uint n, out float logit, out vec3 d, out vec4 turn, out vec3 p) {
    vec3 canonical = read_mean(g, n);
    logit = opacity_logit[g];
    d = vec3(0.0);
    turn = vec4(1.0, 0.0, 0.0, 0.0);
    p = vec3(0.0);
    bool logit_is_nan = (floatBitsToUint(logit) & 0x7fffffffu) > 0x7f800000u;
    bool usable = within(canonical, MAX_ABS_MEAN) && !logit_is_nan;
    if (usable) {
        usable = place_mean(g, n, canonical, d, turn);
    }
    if (usable) {
        p = vec3(dot(frame.world_to_camera_0.xyz, d), dot(frame.world_to_camera_1.xyz, d),
                 dot(frame.world_to_camera_2.xyz, d));
        usable = is_finite(p);
    }
    return usable;
}

// Blurs a Gaussian by its smoothing; false when that is unusable.
bool smooth_shape(uint g, uint n, inout Shape shape, inout float log2_opacity) {
    bool usable = true;
    uint has = OPTIONAL;
    if ((has & HAS_SMOOTHING) != 0u) {
        float sigma = optional[OPTIONAL_SMOOTHING(has) * n + g];
        usable = abs(sigma) <= MAX_SCALE;
        vec3 share;
        shape.scale = smoothed(shape.scale, sigma, share);
        log2_opacity += 0.5 * (log2(share.x) + log2(share.y) + log2(share.z));
    }
    return usable;
}

// The ellipse of the splat, its opacity where smoothed or antialiased, and the variance along x in units of the footprint.
bool project_shape(uint g, uint n, vec4 turn, vec3 p, inout Ellipse e, out float variance_x) {
    variance_x = 0.0;
    Shape shape;
    bool usable = place_shape(g, n, turn, shape) && smooth_shape(g, n, shape, e.log2_opacity);
    if (usable) {
        vec3 axis_0;
        vec3 axis_1;
        vec3 axis_2;
        quaternion_columns(shape.q, axis_0, axis_1, axis_2);
        mat3 rows = mat3(frame.world_to_camera_0.xyz, frame.world_to_camera_1.xyz, frame.world_to_camera_2.xyz);
        vec2 slope = p.xy / p.z;
        vec2 tangent = min(max(slope, frame.tan_limit.xz), frame.tan_limit.yw);
        // `v * rows` is the product of the matrix with these rows by v.
        Footprint footprint = footprint_of(axis_0 * rows, axis_1 * rows, axis_2 * rows, shape.scale / p.z, tangent,
                                           frame.intrinsics.xy);
        vec4 root = conic_root(footprint);
        e.mean = frame.intrinsics.xy * slope + frame.intrinsics.zw;
        e.l11 = root.x;
        e.l12 = root.y;
        e.l22 = root.z;
        variance_x = root.w;
        uint antialiased = ANTIALIASED;
        if (antialiased == 1u) {
            // A Gaussian without an area on screen has no opacity: minus infinity.
            e.log2_opacity += 0.5 * log2(footprint.minors / footprint.det);
        }
        bool finite_mean = is_finite(vec3(e.mean, 0.0));
        bool finite_root = is_finite(root.xyz);
        bool positive = all(greaterThan(root.xz, vec2(0.0)));
        usable = finite_mean && finite_root && positive;
    }
    return usable;
}

// Colour, and then the splat; false and nothing written when the colour is unusable.
bool write_splat(uint g, uint n, Ellipse e, float z, vec3 d) {
    vec3 colour = 0.5 + sh_sum(g, n, d / sqrt(dot(d, d)));
    bool usable = within(colour, MAX_ABS_COLOUR);
    if (usable) {
        uvec4 first;
        uvec4 second;
        uvec4 third;
        pack_splat(vec4(e.mean, e.l11, e.l12), vec3(e.l22, e.log2_opacity, z), max(colour, vec3(0.0)), first, second, third);
        uint stride = splat_stride();
        splats[stride * g] = first;
        splats[stride * g + 1u] = second;
        if (stride == 3u) {
            splats[stride * g + 2u] = third;
        }
    }
    return usable;
}

// Log2 of the share of the opacity that the optional parameters leave at the frame's time.
float log2_share(uint g, uint n) {
    uint has = OPTIONAL;
    float share = 0.0;
    if ((has & HAS_LIFESPAN) != 0u) {
        uint plane = OPTIONAL_LIFESPAN(has);
        float x = lifespan_place(frame.time, optional[plane * n + g], optional[(plane + 1u) * n + g]);
        share -= HALF_LOG2_E * x * x;
    }
    return share;
}

// The number of tiles that the Gaussian reaches. Without LISTS it is counted for each of them: how many more tile k has than tile
// k - 1, in row-major order (scan_tiles adds up). So a row of tiles costs two atomics, however long it is.
uint count_tiles(Ellipse e, uvec2 rows) {
    Extent extent = extent_of(e);
    uint lists = LISTS;
    uint count = 0u;
    for (uint row = rows.x; row < rows.y; row++) {
        uvec2 columns = tile_columns_of_row(e, extent, row, frame.size);
        if (columns.x < columns.y) {
            if (lists == 0u) {
                uint first = row * frame.tiles.x;
                atomicAdd(tile_end[(first + columns.x) * TILE_PITCH], 1u);
                atomicAdd(tile_end[(first + columns.y) * TILE_PITCH], 0xffffffffu);
            }
            count += columns.y - columns.x;
        }
    }
    return count;
}

// Processes Gaussian g; the reads come in the order in which the tests need them. No early return: see lib/place.glsl.
uint project(uint g, uint n, out uint tiles, out Ellipse e, out uint depth) {
    tiles = 0u;
    depth = 0u;
    float logit;
    vec3 d;
    vec4 turn;
    vec3 p;
    float variance_x = 0.0;
    uvec2 rows = uvec2(0u);
    uint outcome = place_centre(g, n, logit, d, turn, p) ? VISIBLE : REJECTED;
    if (outcome == VISIBLE) {
        e.log2_opacity = -log2(1.0 + exp(-logit)) + log2_share(g, n);
        outcome = p.z > frame.near && ellipse_threshold(e) > 0.0 ? VISIBLE : CULLED;
    }
    if (outcome == VISIBLE) {
        outcome = project_shape(g, n, turn, p, e, variance_x) ? VISIBLE : REJECTED;
    }
    if (outcome == VISIBLE) {
        e.log2_opacity = round_opacity(e.log2_opacity);
        if (ellipse_threshold(e) > 0.0 && reaches_image(e, variance_x)) {
            rows = tile_row_range(e, frame.size);
        }
        outcome = rows.x < rows.y ? VISIBLE : CULLED;
    }
    // The colour before the tiles: what is rejected for it is in no tile.
    if (outcome == VISIBLE) {
        outcome = write_splat(g, n, e, p.z, d) ? VISIBLE : REJECTED;
    }
    if (outcome == VISIBLE) {
        depth = floatBitsToUint(p.z);
        tiles = count_tiles(e, rows);
        outcome = tiles != 0u ? VISIBLE : CULLED;
    }
    return outcome;
}

void main() {
    uint group = workgroup_index();
    uint thread = thread_index();
    uint g = group * 256u + thread;
    uint n = frame.gaussians;
    uint tiles = 0u;
    uint depth = 0u;
    Ellipse e;
    uint outcome = CULLED;
    if (g < n) {
        outcome = project(g, n, tiles, e, depth);
        tile_count[g] = tiles;
    }

    uint flags = subgroupAdd(outcome == VISIBLE ? 1u : outcome == REJECTED ? 0x10000u : 0u);
    uint tiles_of_subgroup = subgroupAdd(tiles);
    if (gl_SubgroupInvocationID == 0u) {
        subgroup_flags[gl_SubgroupID] = flags;
        subgroup_tiles[gl_SubgroupID] = tiles_of_subgroup;
    }
    barrier();
    if (thread == 0u && group * 256u < n) {
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
        instance_block[group] = total_tiles;
        if (visible > 0u) {
            atomicAdd(instance_block[push.block_capacity + group / SCAN_SUPER], total_tiles);
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
    uint lists = LISTS;
    if (lists == 1u) {
        // Of Gaussians with many tiles all threads read the splat.
        memoryBarrierBuffer();
        append_block(group, thread, g, tiles, e, depth, 0u);
    }
}

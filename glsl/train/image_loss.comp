#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Gradient of (1 - lambda) L1 + lambda (1 - SSIM) by the rendered image, and the sums of L1 and MSE. Through SSIM it is
//   G*(dS/dmu_x) + 2 x G*(dS/dE[x^2 + y^2]) + 2 (x - y) G*(dS/dE[d^2])
// with G* the convolution with the (symmetric) window.

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 1) const uint TARGET = 0u;    // 0: RGBA8, 1: float bits
layout(constant_id = 2) const uint WITH_SSIM = 1u; // 0: lambda is 0 and `ssim_maps` is not read

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#define STEP_BINDING 1
#include "lib/step.glsl"
#define COLOR_BINDING 2
#define TARGET_BINDING 3
#include "lib/image_target.glsl"
#include "lib/ssim.glsl"

layout(std430, set = 0, binding = 4) readonly buffer SsimMapsBlock { float ssim_maps[]; };
layout(std430, set = 0, binding = 5) writeonly buffer ImageGradientBlock { float image_gradient[]; };
layout(std430, set = 0, binding = 6) writeonly buffer LossPartialBlock { float loss_partial[]; };
#define STATUS_BINDING 7
#include "lib/status.glsl"

// Two of the three maps, then the third: with all of them shared memory would leave too few subgroups in flight.
shared float maps[2 * 58 * 33];
shared vec2 sums[32]; // one per subgroup: 128 / 4

const uint MAP_WORDS = 1914u; // 58 * 33

// Row pass: the three maps of a run of pixels.
void convolve_row(uint task, uvec2 corner, uint channel, out vec3 sum[ROW_RUN]) {
    uint pixels = image_size.x * image_size.y;
    uint row = task % TILE_ROWS;
    uint first = ROW_RUN * (task / TILE_ROWS);
    int y = int(corner.y + row) - int(WINDOW_RADIUS);
    int x = int(corner.x + first) - int(WINDOW_RADIUS);
    bool row_inside = y >= 0 && y < int(image_size.y);
    [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
        sum[j] = vec3(0.0);
    }
    [[unroll]] for (uint i = 0u; i < ROW_INPUTS; i++) {
        int column = x + int(i);
        vec3 m = vec3(0.0);
        if (row_inside && column >= 0 && column < int(image_size.x)) {
            uint at = 3u * channel * pixels + uint(y) * image_size.x + uint(column);
            m = vec3(ssim_maps[at], ssim_maps[at + pixels], ssim_maps[at + 2u * pixels]);
        }
        [[unroll]] for (uint k = 0u; k < WINDOW_SIZE; k++) {
            if (i >= k && i - k < ROW_RUN) {
                sum[i - k] += WINDOW[k] * m;
            }
        }
    }
}

// Column pass: two maps of a run of pixels.
void convolve_column_of_two(uint task, out vec2 sum[COLUMN_RUN]) {
    uint first = COLUMN_RUN * (task / LOSS_TILE_WIDTH);
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        sum[j] = vec2(0.0);
    }
    [[unroll]] for (uint i = 0u; i < COLUMN_INPUTS; i++) {
        uint at = (first + i) * ROW_STRIDE + task % LOSS_TILE_WIDTH;
        vec2 m = vec2(maps[at], maps[MAP_WORDS + at]);
        [[unroll]] for (uint k = 0u; k < WINDOW_SIZE; k++) {
            if (i >= k && i - k < COLUMN_RUN) {
                sum[i - k] += WINDOW[k] * m;
            }
        }
    }
}

// The same for the third map.
void convolve_column_of_one(uint task, out float sum[COLUMN_RUN]) {
    uint first = COLUMN_RUN * (task / LOSS_TILE_WIDTH);
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        sum[j] = 0.0;
    }
    [[unroll]] for (uint i = 0u; i < COLUMN_INPUTS; i++) {
        float m = maps[(first + i) * ROW_STRIDE + task % LOSS_TILE_WIDTH];
        [[unroll]] for (uint k = 0u; k < WINDOW_SIZE; k++) {
            if (i >= k && i - k < COLUMN_RUN) {
                sum[i - k] += WINDOW[k] * m;
            }
        }
    }
}

// Gradients of a run of pixels. Returns their sums of |d| and d^2.
vec2 store_run(uint task, uvec2 corner, uint channel, vec2 two[COLUMN_RUN], float one[COLUMN_RUN]) {
    uint kind = TARGET;
    uint with_ssim = WITH_SSIM;
    uint first = COLUMN_RUN * (task / LOSS_TILE_WIDTH);
    uint x = corner.x + task % LOSS_TILE_WIDTH;
    float lambda = with_ssim == 1u ? step_data.weight_dssim : 0.0;
    float per_value = 1.0 / (3.0 * float(image_size.x * image_size.y));
    vec2 total = vec2(0.0);
    uint bad_count = 0u;
    uint first_bad = 0xffffffffu;
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        uint y = corner.y + first + j;
        if (x < image_size.x && y < image_size.y) {
            uint at = y * image_size.x + x;
            vec3 v = image_and_target(kind, at, channel);
            float d = v.x - v.y;
            float by_ssim = two[j].x + 2.0 * v.x * two[j].y + 2.0 * d * one[j];
            float gradient = per_value * ((1.0 - lambda) * sign(d) - lambda * by_ssim);
            bool good = v.z != 0.0 && number_is_finite(gradient);
            bad_count += good ? 0u : 1u;
            first_bad = good ? first_bad : min(first_bad, at);
            image_gradient[4u * at + channel] = good ? gradient : 0.0;
            total += vec2(abs(d), d * d);
        }
    }
    if (bad_count != 0u) {
        atomicAdd(status[2u * STATUS_IMAGE_GRADIENT], bad_count);
        atomicMin(status[2u * STATUS_IMAGE_GRADIENT + 1u], first_bad);
    }
    // A loop of its own: without rounds it costs less than a branch in the loop above on devices that run both sides.
    uint last = channel == 2u && x < image_size.x ? min(COLUMN_RUN, image_size.y - min(image_size.y, corner.y + first)) : 0u;
    for (uint j = 0u; j < last; j++) {
        image_gradient[4u * ((corner.y + first + j) * image_size.x + x) + 3u] = 0.0;
    }
    return total;
}

void main() {
    uint with_ssim = WITH_SSIM;
    uint group = workgroup_index();
    uint channel = group % 3u;
    read_frame(channel);
    uvec2 tiles = loss_tiles(image_size);
    uint groups = 3u * tiles.x * tiles.y;
    uint tile = group / 3u;
    uvec2 corner = uvec2(LOSS_TILE_WIDTH, LOSS_TILE_HEIGHT) * uvec2(tile % tiles.x, tile / tiles.x);
    uint thread = thread_index();
    uint size = SUBGROUP_SIZE;

    vec2 two[COLUMN_RUN];
    float one[COLUMN_RUN];
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        two[j] = vec2(0.0);
        one[j] = 0.0;
    }
    if (with_ssim == 1u) {
        bool has_row = thread < ROW_TASKS;
        uint row_at = row_of(thread);
        vec3 row[ROW_RUN];
        if (has_row) {
            convolve_row(thread, corner, channel, row);
            [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
                maps[row_at + j] = row[j].x;
                maps[MAP_WORDS + row_at + j] = row[j].y;
            }
        }
        barrier();
        convolve_column_of_two(thread, two);
        barrier();
        if (has_row) {
            [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
                maps[row_at + j] = row[j].z;
            }
        }
        barrier();
        convolve_column_of_one(thread, one);
    }
    vec2 total = store_run(thread, corner, channel, two, one);
    vec2 of_subgroup = subgroupAdd(total);
    if (gl_SubgroupInvocationID == 0u) {
        sums[gl_SubgroupID] = of_subgroup;
    }
    barrier();
    if (thread == 0u && group < groups) {
        vec2 sum = vec2(0.0);
        for (uint s = 0u; s < LOSS_THREADS / size; s++) {
            sum += sums[s];
        }
        loss_partial[groups + group] = sum.x;
        loss_partial[2u * groups + group] = sum.y;
    }
}

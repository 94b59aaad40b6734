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
layout(constant_id = 1) const uint TARGET = 0u;    // 0: RGBA8, 1: float bits, 2: RGBA8, some pixels left out
layout(constant_id = 2) const uint WITH_SSIM = 1u; // 0: lambda is 0 and `ssim_maps` is not read
layout(constant_id = 3) const uint STAGE = 1u;     // as lib/ssim.glsl has it

#include "lib/frame.glsl"
#include "lib/dispatch.glsl"
#include "lib/thread.glsl"
#define STEP_BINDING 1
#include "lib/step.glsl"
#define COLOR_BINDING 2
#define TARGET_BINDING 3
#include "lib/image_target.glsl"
#include "lib/ssim.glsl"

layout(std430, set = 0, binding = 4) readonly buffer SsimMapsBlock { vec4 ssim_maps[]; };
layout(std430, set = 0, binding = 5) writeonly buffer ImageGradientBlock { float image_gradient[]; };
layout(std430, set = 0, binding = 6) writeonly buffer LossPartialBlock { float loss_partial[]; };
#define STATUS_BINDING 7
#include "lib/status.glsl"

// Two of the three maps, then the third: with all of them shared memory would leave too few subgroups in flight.
shared float maps[2 * 58 * 33];
shared vec2 sums[32]; // one per subgroup: 128 / 4

const uint MAP_WORDS = 1914u; // 58 * 33

// Copies: a device may read storage again at every use.
float lambda;
float per_value; // weight of one value in a mean over all

// Over the thread's pixels: sums of |d| and d^2, and what is not finite.
vec2 total = vec2(0.0);
uint bad_count = 0u;
uint first_bad = 0xffffffffu;

// by_moment: convolved derivatives of SSIM.
void store_pixel(uint channel, uvec2 pixel, vec3 by_moment) {
    uint kind = TARGET;
    uint at = pixel.y * image_size.x + pixel.x;
    vec3 v = image_and_target(kind, at, channel);
    float d = v.x - v.y;
    float by_ssim = by_moment.x + 2.0 * v.x * by_moment.y + 2.0 * d * by_moment.z;
    float gradient = per_value * ((1.0 - lambda) * sign(d) - lambda * by_ssim);
    gradient = v.z == MASKED ? 0.0 : gradient;
    bool good = v.z != UNUSABLE && number_is_finite(gradient);
    bad_count += good ? 0u : 1u;
    first_bad = good ? first_bad : min(first_bad, at);
    image_gradient[4u * at + channel] = good ? gradient : 0.0;
    total += vec2(abs(d), d * d);
}

// The component that is no channel, of `count` pixels from pixel `at` on, `step` pixels apart. A loop of its own: without rounds
// it costs less than a branch for each pixel on devices that run both sides.
void clear_fourth(uint at, uint count, uint step) {
    for (uint i = 0u; i < count; i++) {
        image_gradient[4u * (at + i * step) + 3u] = 0.0;
    }
}

// Convolves 16 columns of a row of the maps, from four at a time. The first is a multiple of 4, and WINDOW_RADIUS before it lies
// in the second four.
void convolve_row(uint channel, uint column, int row) {
    uint size = map_size(image_size);
    uint stride = map_stride(image_size);
    bool inside = row >= 0 && row < int(image_size.y);
    clear_row_sums();
    [[unroll]] for (uint q = 0u; q < STRIP_COLUMNS / 4u + 4u; q++) {
        vec4 by_mean = vec4(0.0);
        vec4 by_sum = vec4(0.0);
        vec4 by_difference = vec4(0.0);
        uint four = column / 4u + q; // two too many
        if (inside && four >= 2u && four - 2u < stride) {
            uint at = 3u * channel * size + uint(row) * stride + four - 2u;
            by_mean = ssim_maps[at];
            by_sum = ssim_maps[at + size];
            by_difference = ssim_maps[at + 2u * size];
        }
        [[unroll]] for (uint c = 0u; c < 4u; c++) {
            uint i = 4u * q + c; // three too many
            if (i >= 3u && i - 3u < STRIP_INPUTS) {
                add_input(i - 3u, vec4(by_mean[c], by_sum[c], by_difference[c], 0.0));
            }
        }
    }
}

void walk_strip(uint channel, uvec2 corner) {
    clear_column_sums();
    uint with_ssim = WITH_SSIM;
    uint margin = with_ssim == 1u ? WINDOW_RADIUS : 0u;
    uint end = min(corner.y + STRIP_ROWS, image_size.y);
    uint rounds = corner.y < end ? end - corner.y + 2u * margin : 0u;
    for (uint r = 0u; r < rounds; r++) {
        if (with_ssim == 1u) {
            convolve_row(channel, corner.x, int(corner.y + r) - int(margin));
            add_row_sums();
        }
        uvec2 first = corner + uvec2(0u, r - 2u * margin);
        bool complete = r >= 2u * margin;
        [[unroll]] for (uint j = 0u; j < STRIP_COLUMNS; j++) {
            if (complete && corner.x + j < image_size.x) {
                store_pixel(channel, first + uvec2(j, 0u), column_sum[j].xyz);
            }
        }
        uint columns = min(STRIP_COLUMNS, image_size.x - corner.x);
        clear_fourth(first.y * image_size.x + first.x, complete && channel == 2u ? columns : 0u, 1u);
    }
}

// STAGE 1, column pass: two maps of a run of pixels.
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

void store_run(uint task, uvec2 corner, uint channel, vec2 two[COLUMN_RUN], float one[COLUMN_RUN]) {
    uvec2 first = corner + uvec2(task % LOSS_TILE_WIDTH, COLUMN_RUN * (task / LOSS_TILE_WIDTH));
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        uvec2 pixel = first + uvec2(0u, j);
        if (all(lessThan(pixel, image_size))) {
            store_pixel(channel, pixel, vec3(two[j], one[j]));
        }
    }
    uint rows = min(COLUMN_RUN, image_size.y - min(image_size.y, first.y));
    clear_fourth(first.y * image_size.x + first.x, channel == 2u && first.x < image_size.x ? rows : 0u, image_size.x);
}

void convolve_tile(uint channel, uvec2 corner, uint thread) {
    uint with_ssim = WITH_SSIM;
    vec2 two[COLUMN_RUN];
    float one[COLUMN_RUN];
    [[unroll]] for (uint j = 0u; j < COLUMN_RUN; j++) {
        two[j] = vec2(0.0);
        one[j] = 0.0;
    }
    if (with_ssim == 1u) {
        bool has_row = thread < ROW_TASKS;
        uint row_at = row_of(thread);
        if (has_row) {
            uint column = corner.x + ROW_RUN * (thread / TILE_ROWS);
            convolve_row(channel, column, int(corner.y + thread % TILE_ROWS) - int(WINDOW_RADIUS));
            [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
                maps[row_at + j] = row_sum[j].x;
                maps[MAP_WORDS + row_at + j] = row_sum[j].y;
            }
        }
        barrier();
        convolve_column_of_two(thread, two);
        barrier();
        if (has_row) {
            [[unroll]] for (uint j = 0u; j < ROW_RUN; j++) {
                maps[row_at + j] = row_sum[j].z;
            }
        }
        barrier();
        convolve_column_of_one(thread, one);
    }
    store_run(thread, corner, channel, two, one);
}

void main() {
    uint group = workgroup_index();
    uint channel = group % 3u;
    read_frame(channel);
    uint groups = 3u * loss_groups(image_size);
    uint thread = thread_index();
    uint size = SUBGROUP_SIZE;
    uint stage = STAGE;
    uint with_ssim = WITH_SSIM;
    lambda = with_ssim == 1u ? step_data.weight_dssim : 0.0;
    per_value = 1.0 / (3.0 * float(image_size.x * image_size.y));
    if (stage == 0u) {
        walk_strip(channel, strip_corner(group / 3u, thread, image_size));
    } else {
        convolve_tile(channel, tile_corner(group / 3u, image_size), thread);
    }
    if (bad_count != 0u) {
        atomicAdd(status[2u * STATUS_IMAGE_GRADIENT], bad_count);
        atomicMin(status[2u * STATUS_IMAGE_GRADIENT + 1u], first_bad);
    }
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
